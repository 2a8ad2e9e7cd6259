import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.colours import fit_looks, solve_colours
from pneutac_sim.splat.rasteriser import Splats

BACKGROUND = (0.1, 0.6, 0.3)


def sheet(layers: int = 1):
    """Camera, means and covariances of layers of 24 x 18 Gaussians two pixels apart, seen head-on."""
    x, y, z = np.meshgrid(np.arange(24), np.arange(18), np.arange(layers), indexing="ij")
    means = np.stack([x * 2.0 + 1, y * 2.0 + 1, 100 + z], -1).reshape(-1, 3) * 1e-3
    camera = Camera(np.array([[100.0, 0, 0], [0, 100.0, 0], [0, 0, 1]]), np.eye(4), 48, 36)
    return camera, means, np.tile(np.eye(3) * 1e-6, (len(means), 1, 1))


def rmse(a, b):
    return float(np.sqrt(np.mean(np.square(a - b))))


def test_direct_solution_recovers_known_colours():
    camera, means, covariances = sheet()
    known = np.random.default_rng(0).random((len(means), 3))
    splats = Splats(camera, means, covariances, np.full(len(means), 0.7))
    found = solve_colours(splats, splats.render(known, BACKGROUND).image, BACKGROUND, 60, ridge=1e-6)
    assert np.abs(found - known).max() < 0.02


@pytest.mark.slow
def test_coverage_is_fitted_to_a_silhouette():
    camera, means, covariances = sheet()
    wanted = np.zeros((36, 48))
    wanted[:, :24] = 1
    n = len(means)
    _, before = Splats(camera, means, covariances, np.full(n, 0.5)).render(np.zeros((n, 3)))
    target = np.zeros((36, 48, 3))
    splats = Splats(camera, means, covariances, np.full(n, 0.5))
    _, fitted = fit_looks(splats, target, iterations=300, coverage=wanted)
    _, after = Splats(camera, means, covariances, fitted).render(np.zeros((n, 3)))
    assert rmse(after, wanted) < 0.5 * rmse(before, wanted)


def test_bad_targets_are_refused():
    camera, means, covariances = sheet()
    splats = Splats(camera, means, covariances, np.full(len(means), 0.9))
    with pytest.raises(InputError, match="target"):
        solve_colours(splats, np.full((36, 48, 3), np.nan))
    with pytest.raises(InputError, match="target"):
        solve_colours(splats, np.zeros((48, 36, 3)))
