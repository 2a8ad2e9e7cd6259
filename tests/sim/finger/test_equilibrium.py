"""The loaded spine against the energy it must minimise and against small-load beam statics."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from pneutac_sim.finger.equilibrium import planar, spatial

L = 0.11
N = 4
S = L * (np.arange(N) + 0.5) / N
LINKS = np.diff(np.append(S, L))
K = 0.4


def _links():
    return np.concatenate([LINKS, LINKS / L])


def _points(q):
    """Joint positions and tip (N + 1, 3) for angles (N, 2), link 0 left out."""
    frame, points = Rotation.identity(), [np.zeros(3)]
    for n in range(N):
        frame = frame * Rotation.from_rotvec([0, -q[n, 0], q[n, 1]])
        points.append(points[-1] + LINKS[n] * frame.apply([1, 0, 0]))
    return np.array(points)


def _energy(q, free, load):
    p = _points(q)
    middle = 0.5 * (p[1:] + p[:-1])
    return 0.5 * K * ((q - free) ** 2).sum() - p[-1] @ load[:3] - (LINKS / L) @ middle @ load[3:]


@pytest.mark.parametrize("scale", [0.2, 1.0, 4.0])
def test_spatial_equilibrium_is_the_minimum_of_energy(scale):
    rng = np.random.default_rng(3)
    free = rng.normal(scale=0.2, size=(N, 2))
    load = scale * rng.normal(size=6)
    q = free.reshape(1, -1).copy()
    spatial(q, load[None], K, _links(), np.zeros(2 * N))
    best = minimize(lambda v: _energy(v.reshape(N, 2), free, load), free.ravel(), options={"gtol": 1e-9})
    np.testing.assert_allclose(q[0], best.x, atol=2e-6)


def test_planar_equals_spatial_in_the_plane():
    rng = np.random.default_rng(4)
    free = rng.normal(scale=0.3, size=(20, N))
    loads = rng.normal(size=(20, 6))
    loads[:, [1, 4]] = 0
    a = free.copy()
    planar(a, loads, K, _links(), np.zeros(N))
    b = np.stack([free, 0 * free], -1).reshape(20, -1)
    spatial(b, loads, K, _links(), np.zeros(2 * N))
    np.testing.assert_allclose(b.reshape(20, N, 2)[..., 0], a, atol=1e-9)
    np.testing.assert_allclose(b.reshape(20, N, 2)[..., 1], 0, atol=1e-12)


def test_small_tip_load_bends_each_joint_by_lever_times_force_over_stiffness():
    force = 1e-4
    q = np.zeros((1, N))
    planar(q, np.array([[0, 0, force, 0, 0, 0.0]]), K, _links(), np.zeros(N))
    np.testing.assert_allclose(q[0], force * (L - S) / K, rtol=1e-6)


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("spoilt", ["q", "loads", "stiffness"])
def test_what_is_not_finite_ends_at_once_and_is_no_number(axes, spoilt):
    """No shift makes a matrix of NaN positive definite: the search for one once went on for ever."""
    given = {"q": np.full((5, 4 * axes), 0.1), "loads": np.zeros((5, 6)), "stiffness": np.array([0.4])}
    given["loads"][:, 2] = 0.1
    given[spoilt][2 if spoilt != "stiffness" else 0] = np.nan
    solve = planar if axes == 1 else spatial
    links = np.concatenate([np.full(4, 0.025), np.full(4, 0.25)])
    solve(given["q"], given["loads"], given["stiffness"][0], links, np.zeros(4 * axes))
    first = 0 if spoilt == "stiffness" else 2
    assert np.isfinite(given["q"][:first]).all() and np.isnan(given["q"][first:]).all()
