"""Touch back from images of the model itself, with noise and a drift of the light."""

import time

import numpy as np
import pytest

from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.inverse import BED, TouchReader
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.twin import Twin, Value

BALL = Press("sphere", 3.0, 1.5, -2.0, 0.8)


@pytest.fixture(params=["linear", "bent"])
def gel(request):
    return request.getfixturevalue(request.param)


def test_depth_place_and_surface_come_back_under_noise_and_drift(gel, photograph):
    reader = TouchReader(gel)
    for press in (BALL, Press("cube", 4.0, -1.0, 3.0, 0.5, 0.4), Press("sphere", 4.0, -3.0, -5.0, 1.2)):
        touch = reader.read(photograph(gel, press, noise=2, gain=1.03))
        truth = TactileSensor(gel).displacement(press_depth(press, gel))
        assert touch.depth_mm == pytest.approx(press.depth_mm, rel=0.07)
        np.testing.assert_allclose(touch.centre_mm, (press.x_mm, press.y_mm), atol=0.2)
        assert np.sqrt(np.mean((touch.surface_mm - truth) ** 2)) < 0.07 * truth.max()
        assert touch.normals.shape == (80, 59, 3)
        np.testing.assert_allclose(np.linalg.norm(touch.normals, axis=-1), 1)


def test_nothing_is_felt_where_nothing_touches(gel, photograph):
    far = Press("sphere", 3.0, 0.0, 0.0, 1e-6)
    for gain in (0.95, 1.0):
        touch = TouchReader(gel).read(photograph(gel, far, noise=3, gain=gain))
        assert touch.depth_mm == touch.force_n == touch.area_mm2 == 0 and np.isnan(touch.centre_mm).all()


def test_the_force_is_that_of_a_bed_of_springs_and_of_the_twins_modulus(linear, photograph):
    punch = Press("cube", 4.0, 0.0, 0.0, 0.5)
    image = photograph(linear, punch)
    soft, hard = Twin("gel", 16.0), Twin("gel", 16.0)
    for twin, modulus in ((soft, 0.1), (hard, 0.3)):
        linear.into_twin(twin)
        twin.parameters["gel_youngs_modulus_mpa"] = Value(modulus)
    forces = [TouchReader.of_twin(t).read(image).force_n for t in (soft, hard)]
    assert forces[1] == pytest.approx(3 * forces[0])
    assert forces[0] == pytest.approx(BED * 0.1 / linear.thickness_mm * 4 * 4 * 0.5, rel=0.2)


@pytest.mark.nightly  # compiles the material points
@pytest.mark.parametrize(
    "press",
    [
        Press("sphere", 5.0, 0.5, -0.5, 0.8),
        Press("cube", 4.0, 0.5, -0.5, 0.7),
        Press("edge", 5.0, 0.5, -0.5, 0.8),
    ],
    ids=lambda p: f"{p.indenter} {p.depth_mm}",
)
def test_the_force_is_within_a_third_of_that_of_material_points(press, linear, photograph):
    solver = devices.gel(Twin("gel", 16.0), device="cpu", counts=(30, 40, 6))
    force = np.linalg.norm(solve_equilibrium(solver, devices.press_loads(press)).contact_force[0])
    assert TouchReader(linear).read(photograph(linear, press)).force_n == pytest.approx(force, rel=1 / 3)


def test_thirty_images_a_second_are_read(bent, photograph):
    reader, image = TouchReader(bent), photograph(bent, BALL, noise=2)
    reader.read(image)
    began = time.process_time()
    for _ in range(10):
        reader.read(image)
    assert time.process_time() - began < 10 / 30


def test_another_rest_image_may_be_given_and_other_things_are_refused(linear, photograph):
    reader, image = TouchReader(linear), photograph(linear, BALL)
    darker = (0.8 * linear.rest_image).astype(np.uint8)
    moved = np.clip(darker.astype(int) + image - linear.rest_image, 0, 255).astype(np.uint8)
    assert reader.read(moved, darker).depth_mm == pytest.approx(reader.read(image).depth_mm, rel=0.1)
    for bad in (image.astype(float), image[..., 0]):
        with pytest.raises(ValueError, match="uint8"):
            reader.read(bad)
    assert TouchReader(GelModel.builtin()).read(GelModel.builtin().rest_image).depth_mm == 0
