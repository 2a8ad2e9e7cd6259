from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.gel.contact import contact_area
from pneutac_sim.gel.fit import standard_effects
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import upsample
from pneutac_sim.gel.probe import BOX, CAPSULE, SPHERE
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin


@pytest.fixture(scope="module")
def sensor():
    return TactileSensor()


def press(sensor, kind=SPHERE, z_mm=2.5, euler=(0, 0, 0), x_mm=1.0, y_mm=2.0, size_mm=(3, 3, 3)):
    R = Rotation.from_euler("xyz", euler).as_matrix()
    return sensor.probe([kind], [np.array(size_mm) * 1e-3], [[x_mm * 1e-3, y_mm * 1e-3, z_mm * 1e-3]], [R])


def test_rest_without_contact(sensor):
    image = sensor.image(np.zeros((80, 59), np.float32))
    assert image.shape == (320, 240, 3) and image.dtype == np.uint8
    np.testing.assert_array_equal(image, sensor.rest_image)
    assert sensor.contact(image) == (0, 0.0, 0.0)


@pytest.mark.parametrize("effects", [(), ("rest_colour",), standard_effects()])
def test_fast_path_equals_the_image_exactly(effects):
    rng = np.random.default_rng(0)
    model = GelModel.builtin()
    model.rest_image = rng.integers(0, 256, (320, 240, 3), dtype=np.uint8)  # saturates and rounds everywhere
    model.effects = {e: {p.name: p.default for p in get_effect(e).parameters} for e in effects}
    sensor = TactileSensor(model)
    for i in range(12):
        kind = (SPHERE, CAPSULE, BOX)[i % 3]
        euler, x, y = rng.uniform(-1, 1, 3), rng.uniform(-5, 5), rng.uniform(-7, 7)
        depth = press(sensor, kind, rng.uniform(1, 3), euler, x, y)
        assert sensor.contact_from_depth(depth) == sensor.contact(sensor.image(depth))


def test_areas_of_many_are_each_by_itself():
    """With formulas grid by grid, with a network all that touch at once."""
    sensor = TactileSensor(replace(GelModel.builtin(), depth_scale=0.8))
    depth = np.stack([press(sensor, z_mm=z) for z in (2.5, 9.0, 2.0)])
    areas = [sensor.contact_from_depth(d).area for d in depth]
    assert areas[0] > 0 and areas[1] == 0 and areas[2] > areas[0]
    np.testing.assert_array_equal(sensor.areas(depth), areas)
    shown = []
    sensor.surface = lambda d: (shown.append(d.shape), 0.5 * d)[1]
    halved = [sensor.contact_from_depth(d).area for d in depth]
    assert halved[0] != areas[0]
    shown.clear()
    np.testing.assert_array_equal(sensor.areas(depth), halved)
    assert shown == [(2, 80, 59)]
    assert not sensor.areas(depth[1:2]).any() and len(shown) == 1


def test_skin_draws_the_imprint_back_but_never_below_rest(sensor):
    gel = replace(sensor.model, depth_scale=0.6)
    depth = press(sensor)
    np.testing.assert_allclose(gel.imprint(depth), np.maximum(depth - 0.4 * depth.max(), 0), atol=1e-6)
    assert not gel.imprint(np.zeros_like(depth)).any()
    shallow, deep = (TactileSensor(g).image(depth).astype(int) for g in (gel, sensor.model))
    assert 0 < np.abs(shallow - gel.rest_image).sum() < np.abs(deep - gel.rest_image).sum()


def test_image_is_the_photometric_formula(sensor):
    """c0 + w (L grad u + c_d u), evaluated plainly with numpy, within rounding."""
    m, u = sensor.model, sensor.displacement(press(sensor)).astype(np.float64)
    gy, gx = np.gradient(u, 16 / 80, 12 / 59)
    light = np.stack([upsample(m.light[k, 0] * gx + m.light[k, 1] * gy + m.depth_light[k] * u, 320, 240)
                      for k in range(3)], -1)  # fmt: skip
    w = m.rest_image / m.rest_image.mean((0, 1))
    expected = np.clip(m.rest_image + w * light, 0, 255)
    image = sensor.image(press(sensor)).astype(float)
    # the rim of the grid uses one-sided differences in both
    assert np.abs(image - expected).max() <= 0.51
    assert np.abs(image - m.rest_image).max() > 20


@pytest.mark.parametrize(
    "field, value, says",
    [
        ("light", [[1.0, 2.0]], "light"),
        ("depth_light", [1.0, 2.0, float("nan")], "depth_light"),
        ("px_per_mm", -3.0, "px_per_mm"),
        ("multiply", True, "multiply"),
    ],
)
def test_a_broken_gel_is_named(field, value, says):
    twin = Twin.builtin()
    GelModel.builtin().into_twin(twin)
    twin.gel[field] = value
    with pytest.raises(InputError, match=says):
        TactileSensor(twin)


def test_wrong_sizes_are_refused(sensor):
    with pytest.raises(ValueError, match="probe grid has shape"):
        sensor.image(np.zeros((40, 30), np.float32))
    with pytest.raises(ValueError, match="one shape"):
        contact_area(np.zeros((10, 10, 3), np.uint8), sensor.rest_image)


@pytest.mark.parametrize("value", [-20.0, 1e6, float("nan")])
def test_an_effect_outside_its_bounds_is_refused(value):
    effects = {"near_light": {"distance_red_mm": value, "distance_green_mm": 20.0, "distance_blue_mm": 20.0}}
    with pytest.raises(InputError, match="distance_red_mm = .* between 8 and 1000"):
        replace(GelModel.builtin(), effects=effects)
