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


def picture(camera: Camera) -> np.ndarray:
    y, x = np.mgrid[: camera.height, : camera.width] / 30
    return np.stack([0.5 + 0.4 * np.sin(3 * x), 0.5 + 0.4 * np.cos(2 * y), 0.3 + 0.2 * x], -1).clip(0, 1)


def rmse(a, b):
    return float(np.sqrt(np.mean(np.square(a - b))))


def test_direct_solution_recovers_known_colours():
    camera, means, covariances = sheet()
    known = np.random.default_rng(0).random((len(means), 3))
    splats = Splats(camera, means, covariances, np.full(len(means), 0.7))
    found = solve_colours(splats, splats.render(known, BACKGROUND).image, BACKGROUND, 60, ridge=1e-6)
    assert np.abs(found - known).max() < 0.02


def test_adam_on_opacities_improves_on_the_direct_solution():
    camera, means, covariances = sheet(2)
    target, opacities = picture(camera), np.full(len(means), 0.5)
    errors = []
    splats = Splats(camera, means, covariances, opacities)
    colours, fitted = fit_looks(splats, target, iterations=60, progress=lambda i, e: errors.append(e))
    found = rmse(Splats(camera, means, covariances, fitted).render(colours).image, target)
    assert found == pytest.approx(min(errors), rel=1e-3)
    assert found < 0.8 * errors[0]
    assert 0 <= colours.min() and colours.max() <= 1 and 0.01 <= fitted.min() and fitted.max() <= 0.99


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


def test_hidden_gaussians_get_the_colour_in_front_of_them():
    camera, means, covariances = sheet(6)
    target = picture(camera)
    splats = Splats(camera, means, covariances, np.full(len(means), 0.99))
    colours = solve_colours(splats, target)
    assert np.isfinite(colours).all()
    back = colours.reshape(24, 18, 6, 3)[:, :, 5]
    assert rmse(back, target[1::2, 1::2].transpose(1, 0, 2)) < 0.05


def test_bad_targets_are_refused():
    camera, means, covariances = sheet()
    splats = Splats(camera, means, covariances, np.full(len(means), 0.9))
    with pytest.raises(InputError, match="target"):
        solve_colours(splats, np.full((36, 48, 3), np.nan))
    with pytest.raises(InputError, match="target"):
        solve_colours(splats, np.zeros((48, 36, 3)))
