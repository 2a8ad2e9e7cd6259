import importlib.util

import numpy as np
import pytest
import torch
from splat_reference import scene, view

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.gel.surface import surface
from pneutac_sim.splat.gel import CAMERA_MM, SplatSensor, particles
from pneutac_sim.splat.rasteriser import Splats
from pneutac_sim.splat.render import on, rasterise
from pneutac_sim.world.splats import SplatFinger, camera_of
from pneutac_sim.world.world import World

REST = np.zeros((80, 59), np.float32)


@pytest.fixture(scope="module")
def sensor():
    return SplatSensor(GelModel.builtin())


@pytest.fixture(scope="module")
def pixelwise():
    return TactileSensor(GelModel.builtin())


def press(pixelwise, x_mm, y_mm, depth_mm, radius_mm=3.0):
    """Displacement under a ball."""
    centre = [[1e-3 * x_mm, 1e-3 * y_mm, 1e-3 * (radius_mm - depth_mm)]]
    return pixelwise.displacement(pixelwise.probe([2], [[1e-3 * radius_mm, 0, 0]], centre, [np.eye(3)]))


def rmse(a, b):
    return float(np.sqrt(np.mean(np.square(a.astype(float) - b))))


def test_particles_fill_the_window_and_compress_towards_it():
    model = GelModel.builtin()
    means, fraction = particles(model, 13)
    assert means.shape == (59 * 80 * 13, 3)
    surface, window = means[fraction == 1], means[fraction == 0]
    assert len(surface) == len(window) == 59 * 80
    assert np.allclose(surface[:, 2], 0) and np.allclose(window[:, 2], -1e-3 * model.thickness_mm)
    # cell centres, row by row from the upper left
    width, height = model.window_mm
    assert np.allclose(surface[0, :2], [-0.5e-3 * width * 58 / 59, -0.5e-3 * height * 79 / 80], atol=1e-7)
    assert np.allclose(surface[:59, 1], surface[0, 1]) and np.all(np.diff(surface[:59, 0]) > 0)


def test_the_surface_fills_the_image(sensor):
    width, height = sensor.model.window_mm
    corners = 0.5e-3 * np.array([[-width, -height, 0], [width, height, 0]])
    pixels, depth = sensor.camera.project(corners)
    assert np.allclose(pixels, [[0, 0], [240, 320]])
    assert np.allclose(depth, CAMERA_MM * 1e-3)


def test_no_contact_is_the_rest_image(sensor):
    assert np.array_equal(sensor.image(REST), sensor.model.rest_image)


@pytest.mark.parametrize(("x", "y", "depth"), [(0, 0, 0.5), (0, 0, 1.0), (2, 3, 1.0), (-4, 6, 0.8)])
def test_contact_agrees_with_the_image_plane_renderer(sensor, pixelwise, x, y, depth):
    u = press(pixelwise, x, y, depth)
    by_pixel = pixelwise.draw(u)
    assert rmse(by_pixel, sensor.model.rest_image) > 4
    assert rmse(sensor.image(u), by_pixel) < min(2, 0.2 * rmse(by_pixel, sensor.model.rest_image))


def test_bad_input_is_refused(sensor):
    with pytest.raises(InputError, match="displacement_mm"):
        sensor.image(REST[:5] + np.nan)
    with pytest.raises(InputError, match="thickness"):
        sensor.image(REST + 3.0)
    with pytest.raises(InputError, match="increment"):
        sensor.render(REST, np.zeros((320, 241, 3)))


ABLE = importlib.util.find_spec("gsplat") is not None and torch.cuda.is_available()
needs_cuda = pytest.mark.skipif(not ABLE, reason="needs gsplat and a CUDA device")


@needs_cuda
@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.003, -0.002, 0.01)])
def test_cuda_agrees_with_the_cpu(distortion):
    g, camera = scene(0, 3000, size=0.004), view(distortion, 200, 150)
    here, there = (rasterise(g, camera, (0.2, 0.5, 0.9), device=d) for d in ("cpu", "cuda"))
    assert 0.1 < here.alpha.mean() < 0.99
    for ours, theirs in zip(here, there, strict=True):
        # rounding may lift single pixels over the alpha threshold of 1/255
        assert np.quantile(np.abs(ours - theirs), 0.9995) < 1e-3
        assert np.abs(ours - theirs).max() < 0.02


@needs_cuda
def test_cuda_gradients_agree_with_the_cpu():
    from pneutac_sim.splat.render import rasterise_tensors

    g, camera = scene(0, 500, size=0.004), view((), 200, 150)
    by_image = np.random.default_rng(1).normal(size=(150, 200, 3)).astype(np.float32)
    arrays = (g.means, g.covariances(), g.colours, g.opacities)
    tensors = [torch.from_numpy(a).cuda().requires_grad_() for a in arrays]
    image, _ = rasterise_tensors(*tensors, camera, torch.zeros(3, device="cuda"))
    (image * torch.from_numpy(by_image).cuda()).sum().backward()
    splats = Splats(camera, g.means, g.covariances(), g.opacities)
    ours = splats.gradients(g.colours, (0, 0, 0), by_image)
    for mine, theirs in zip(ours, (tensors[2].grad, tensors[3].grad), strict=True):
        theirs = theirs.cpu().numpy()
        assert np.linalg.norm(mine - theirs) < 2e-3 * np.linalg.norm(theirs)


@needs_cuda
def test_a_touch_and_a_finger_are_drawn_on_cuda_as_on_the_cpu():
    model = GelModel.builtin()
    here = SplatSensor(model)
    there = SplatSensor(model, device="cuda")
    u = surface(press_depth(Press("sphere", 3.0, 0.5, 1.0, 0.9), model))
    assert np.abs(here.image(u).astype(int) - here.image(0 * u)).max() > 30
    off = np.abs(here.image(u).astype(int) - there.image(u))
    assert np.quantile(off, 0.999) <= 1 and off.max() < 6
    world = World("switch", fidelity="probe")
    world.reset(0)
    camera = camera_of(world.model, world.data, 320, 240)
    pictures = [SplatFinger(world.model, world.twin, d).picture(world.data, camera) for d in ("cpu", "auto")]
    seen = pictures[0][1] > 0.5
    assert seen.sum() > 500
    for ours, theirs in zip(*pictures, strict=True):
        assert np.quantile(np.abs(ours[seen] - theirs[seen]), 0.999) < 1e-3


@pytest.mark.skipif(ABLE, reason="gsplat and a CUDA device are there")
def test_without_cuda_the_remedy_is_named():
    with pytest.raises(InputError, match=r"uv pip install -e .\.\[cuda\]"):
        rasterise(scene(0, 5), view(), device="cuda")
    assert on("auto") is Splats
