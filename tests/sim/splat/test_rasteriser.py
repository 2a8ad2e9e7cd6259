import gc
import multiprocessing
import threading

import numpy as np
import pytest
import torch
from splat_reference import render as reference
from splat_reference import scene, view

from pneutac_sim.errors import InputError
from pneutac_sim.splat import rasteriser
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Splats, _share, _shares
from pneutac_sim.splat.render import Gaussians, rasterise

BACKGROUND = (0.2, 0.5, 0.9)
LENS = (-0.2, 0.05, 0.003, -0.002, 0.01)


def splats_of(g: Gaussians, camera: Camera) -> Splats:
    return Splats(camera, g.means, g.covariances(), g.opacities)


def reference_of(g: Gaussians, camera: Camera, background):
    colours, opacities = (
        torch.tensor(v.astype(np.float64), requires_grad=True) for v in (g.colours, g.opacities)
    )
    image, alpha = reference(camera, g.means, g.covariances(), colours, opacities, background)
    return image, alpha, colours, opacities


@pytest.mark.parametrize("distortion", [(), LENS])
@pytest.mark.parametrize("seed", range(3))
def test_picture_agrees_with_the_dense_reference(seed, distortion):
    g, camera = scene(seed, 400), view(distortion)
    ours = rasterise(g, camera, BACKGROUND)
    image, alpha, *_ = reference_of(g, camera, BACKGROUND)
    assert 0.1 < ours.alpha.mean() < 0.95
    assert np.abs(ours.image - image.detach().numpy()).max() < 1e-3
    assert np.abs(ours.alpha - alpha.detach().numpy()).max() < 1e-3


@pytest.mark.parametrize("distortion", [(), LENS])
def test_gradients_agree_with_autograd(distortion):
    g, camera = scene(7, 150), view(distortion)
    rng = np.random.default_rng(1)
    by_image = rng.normal(size=(51, 70, 3))
    by_alpha = rng.normal(size=(51, 70))
    image, alpha, colours, opacities = reference_of(g, camera, BACKGROUND)
    ((image * torch.tensor(by_image)).sum() + (alpha * torch.tensor(by_alpha)).sum()).backward()
    grad_colours, grad_opacities = splats_of(g, camera).gradients(g.colours, BACKGROUND, by_image, by_alpha)
    for ours, theirs in ((grad_colours, colours.grad.numpy()), (grad_opacities, opacities.grad.numpy())):
        assert np.abs(theirs).max() > 1
        assert np.abs(ours - theirs).max() < 1e-3 * np.abs(theirs).max()


def test_one_gaussian_has_the_analytic_profile():
    f, z, s = 200.0, 0.4, 0.01
    camera = Camera(np.array([[f, 0, 30.5], [0, f, 20.5], [0, 0, 1]]), np.eye(4), 61, 41)
    g = Gaussians([[0, 0, z]], [[s, s, s]], [np.eye(3)], [[1, 0.5, 0.25]], [0.9])
    image, alpha = rasterise(g, camera)
    y, x = np.mgrid[:41, :61] - np.array([20.0, 30.0])[:, None, None]
    expected = 0.9 * np.exp(-0.5 * (x**2 + y**2) / ((f * s / z) ** 2 + 0.3))
    expected[expected < 1 / 255] = 0
    assert np.abs(alpha - expected).max() < 1e-5
    assert np.abs(image - expected[..., None] * [1, 0.5, 0.25]).max() < 1e-5


def test_what_is_behind_or_beside_the_camera_is_not_drawn():
    camera = view()
    back = np.linalg.inv(camera.extrinsics) @ [[0, 0, 5], [0, 0, 0], [-0.2, 1e-5, 0.1], [1, 1, 1]]
    n = back.shape[1]
    g = Gaussians(
        back[:3].T, np.full((n, 3), 0.01), np.tile(np.eye(3), (n, 1, 1)), np.ones((n, 3)), np.ones(n)
    )
    rendering = rasterise(g, camera, BACKGROUND)
    assert not rendering.alpha.any()
    assert np.allclose(rendering.image, BACKGROUND)


@pytest.mark.parametrize("field", ["means", "rotations", "opacities"])
def test_nan_is_refused(field):
    g = scene(0, 5)
    values = {
        name: np.array(getattr(g, name)) for name in ("means", "scales", "rotations", "colours", "opacities")
    }
    values[field][2] = np.nan
    with pytest.raises(InputError, match=field):
        Gaussians(**values)


def test_bad_input_is_refused():
    g, camera = scene(0, 5), view()
    splats = splats_of(g, camera)
    with pytest.raises(InputError, match="colours"):
        splats.render(g.colours[:3])
    with pytest.raises(InputError, match="background"):
        splats.render(g.colours, (0, np.nan, 0))
    with pytest.raises(InputError, match="image"):
        splats.transpose(np.zeros((51, 71, 3)))
    with pytest.raises(InputError, match="between 0 and 1"):
        Splats(camera, g.means, g.covariances(), g.opacities + 1)
    with pytest.raises(InputError, match="covariances"):
        Splats(camera, g.means, np.full((5, 3, 3), np.inf), g.opacities)
    with pytest.raises(InputError, match="inside out"):
        g.moved(g.means, np.tile(np.diag([1.0, 1.0, -1.0]), (5, 1, 1)))
    with pytest.raises(InputError, match="'cpu' or 'cuda'"):
        rasterise(g, camera, device="tpu")


def _mean(seed):
    return float(rasterise(scene(seed, 50), view()).image.mean())


def test_works_in_a_forked_process_and_on_one_thread(monkeypatch):
    expected = _mean(0)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(_mean, (0,)).get(timeout=300) == expected
    for threads in (1, 2):
        monkeypatch.setattr(rasteriser, "_shares", lambda threads=threads: threads)
        assert _mean(0) == pytest.approx(expected, rel=1e-6)


def test_no_garbage_is_collected_in_a_rendering_thread():
    """A solver's arrays on a GPU may be freed by their own thread alone."""

    class Watched:
        def __init__(self):
            self.me = self  # only the collector frees it

        def __del__(self):
            freed.append(threading.current_thread())

    freed, seen = [], []

    def kernel(share, shares):
        Watched()
        seen.append(threading.current_thread())
        [[] for _ in range(200_000)]  # far beyond the collector's threshold

    _share(kernel)
    gc.collect()
    assert len(seen) == _shares() and gc.isenabled()
    assert set(freed) == {threading.main_thread()}
