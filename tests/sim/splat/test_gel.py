import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.splat.gel import CAMERA_MM, SplatSensor, particles

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
    with pytest.raises(InputError, match="layers"):
        SplatSensor(sensor.model, layers=1)
    with pytest.raises(InputError, match="colours"):
        SplatSensor(sensor.model, layers=5, looks=sensor.looks)
    with pytest.raises(InputError, match="displacement_mm"):
        sensor.image(REST[:5] + np.nan)
    with pytest.raises(InputError, match="thickness"):
        sensor.image(REST + 3.0)
    with pytest.raises(InputError, match="increment"):
        sensor.render(REST, np.zeros((320, 241, 3)))
