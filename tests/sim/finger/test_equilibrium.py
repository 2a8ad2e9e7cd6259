"""The loaded spine against the energy it must minimise and against small-load beam statics."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from pneutac_sim.finger.equilibrium import along_a_line, sensitivities, solve
from pneutac_sim.finger.kinematics import forward_kinematics, forward_kinematics_spatial

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
    solve(q, load[None], K, _links(), np.zeros(2 * N))
    best = minimize(lambda v: _energy(v.reshape(N, 2), free, load), free.ravel(), options={"gtol": 1e-9})
    np.testing.assert_allclose(q[0], best.x, atol=2e-6)


def test_planar_equals_spatial_in_the_plane():
    rng = np.random.default_rng(4)
    free = rng.normal(scale=0.3, size=(20, N))
    loads = rng.normal(size=(20, 6))
    loads[:, [1, 4]] = 0
    a = free.copy()
    solve(a, loads, K, _links(), np.zeros(N))
    b = np.stack([free, 0 * free], -1).reshape(20, -1)
    solve(b, loads, K, _links(), np.zeros(2 * N))
    np.testing.assert_allclose(b.reshape(20, N, 2)[..., 0], a, atol=1e-9)
    np.testing.assert_allclose(b.reshape(20, N, 2)[..., 1], 0, atol=1e-12)


def test_small_tip_load_bends_each_joint_by_lever_times_force_over_stiffness():
    force = 1e-4
    q = np.zeros((1, N))
    solve(q, np.array([[0, 0, force, 0, 0, 0.0]]), K, _links(), np.zeros(N))
    np.testing.assert_allclose(q[0], force * (L - S) / K, rtol=1e-6)


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("spoilt", ["q", "loads", "stiffness"])
def test_what_is_not_finite_ends_at_once_and_is_no_number(axes, spoilt):
    """No shift makes a matrix of NaN positive definite: the search for one once went on for ever."""
    given = {"q": np.full((5, 4 * axes), 0.1), "loads": np.zeros((5, 6)), "stiffness": np.array([0.4])}
    given["loads"][:, 2] = 0.1
    given[spoilt][2 if spoilt != "stiffness" else 0] = np.nan
    links = np.concatenate([np.full(4, 0.025), np.full(4, 0.25)])
    solve(given["q"], given["loads"], given["stiffness"][0], links, np.zeros(4 * axes))
    first = 0 if spoilt == "stiffness" else 2
    assert np.isfinite(given["q"][:first]).all() and np.isnan(given["q"][first:]).all()


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("scale", [0.0, 0.3, 2.0])
def test_outputs_change_as_differences_of_solutions_do(axes, scale):
    rng, n = np.random.default_rng(6), 3
    free, loads = rng.normal(scale=0.3, size=(n, axes * N)), scale * rng.normal(size=(n, 6))
    by_markers = rng.normal(size=(n, 2, 5))
    if axes == 1:
        by_markers[:, :, [1, 4]] = 0.0

    def seen(free, loads, stiffness):
        q = free.copy()
        solve(q, loads, stiffness, _links(), np.zeros(axes * N))
        markers = np.zeros((n, 5))
        if axes == 1:
            tip, markers[:, 3] = forward_kinematics(q, 1e3 * S, 1e3 * L)
            markers[:, [0, 2]] = tip
        else:
            markers[:, :3], markers[:, 3:] = forward_kinematics_spatial(q.reshape(n, N, 2), 1e3 * S, 1e3 * L)
        return q, np.einsum("ndm,nm->nd", by_markers, markers)

    q, _ = seen(free, loads, K)
    by_free, by_load, by_stiffness = np.empty((n, 2, axes * N)), np.zeros((n, 2, 6)), np.zeros((n, 2))
    sensitivities(q, free, loads, K, _links(), by_markers, by_free, by_load, by_stiffness)

    def check(got, moved):
        slope = (moved(1e-4)[1] - moved(-1e-4)[1]) / 2e-4
        np.testing.assert_allclose(got, slope, atol=1e-5 * np.abs(slope).max() + 1e-4)

    for i, e in enumerate(np.eye(axes * N)):
        check(by_free[:, :, i], lambda d, e=e: seen(free + d * e, loads, K))
    for i, e in enumerate(np.eye(6)):
        check(by_load[:, :, i], lambda d, e=e: seen(free, loads + d * e, K))
    check(by_stiffness, lambda d: seen(free, loads, K + d))


def test_deflections_along_a_line_are_those_of_every_row():
    rng = np.random.default_rng(8)
    free = 0.1 + rng.uniform(0, 1, (2000, 1)) * np.array([[0.3, 0.25, 0.2, 0.3]])
    loads = np.repeat(0.5 * rng.normal(size=(4, 6)), 500, axis=0)
    expected = free.copy()
    solve(expected, loads, K, _links(), np.zeros(N))
    np.testing.assert_allclose(along_a_line(free, loads, K, _links()), expected, atol=1e-7)
    assert np.abs(expected - free).max() > 0.05
    assert along_a_line(free, rng.normal(size=(2000, 6)), K, _links()) is None
    free[3] = np.nan
    assert along_a_line(free, loads, K, _links()) is None
