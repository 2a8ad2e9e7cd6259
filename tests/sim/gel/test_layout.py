"""Which way round a sensor's images are, told by the directions of its light.

Punches with an outline and meshes: the same depths as the plain shapes where they are the same.

What earlier presses leave in a gel that creeps.

The residual field: learnt where five presses show one, not where there is none, and kept with the twin.
"""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from sensors import wavy

from pneutac_datasets.generate.gel import write_hidden_gel
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.effects import get_effect
from pneutac_sim.effects.gel_creep import share_left
from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.effects.shadow import cast
from pneutac_sim.errors import InputError
from pneutac_sim.gel import layout
from pneutac_sim.gel.batch import TactileBatch
from pneutac_sim.gel.fit import fit_photographs, fit_presses
from pneutac_sim.gel.indenter import Figure, Outline, Press
from pneutac_sim.gel.layout import (
    DIGIT,
    LIKE,
    MATCH_DEG,
    Orientation,
    orientations,
    recognise,
    recognise_rest,
)
from pneutac_sim.gel.model import GelModel, rest_image
from pneutac_sim.gel.optics import gradient, light
from pneutac_sim.gel.pair import Earlier, PressPhotograph, rmse, to_grid
from pneutac_sim.gel.photograph import Predictor, Residues, press_depth
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.residual import (
    FEATURES,
    LEAST_MM,
    MOVED_MM,
    SLOPE,
    Leftover,
    ResidualField,
    features,
    levels,
    trusted_share,
)
from pneutac_sim.gel.sensor import Memory, TactileSensor, branches_of, pressed_on
from pneutac_sim.gel.surface import surface
from pneutac_sim.mpm.indenter import centre_m, distances_m, half_edge_m
from pneutac_sim.world.mpm_gel import signed_distance

PLACES = [(0.0, 0.0), (-2.0, 3.0)]
SIZE = (240, 320)


def light_of(layout, x_mm, y_mm):
    """L (3, 2) of a layout's lights at a place, of unlike strengths."""
    away = np.array([x_mm, y_mm]) - layout.positions_mm
    return away / np.linalg.norm(away, axis=1)[:, None] * np.array([[120.0], [80.0], [40.0]])


def mismatch_deg(layout, light, x_mm, y_mm):
    """Largest angle between the layout's directions and the light's."""
    a, b = light_of(layout, x_mm, y_mm), light
    cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))).max()


@pytest.mark.parametrize("orientation", orientations(), ids=str)
@pytest.mark.parametrize("x_mm, y_mm", PLACES)
def test_every_order_of_channels_and_mirroring_is_found(orientation, x_mm, y_mm):
    """Or upright, where the make's own orientation fits within the limit as well."""
    light = light_of(orientation.of(DIGIT), x_mm, y_mm)
    found = recognise(light, x_mm, y_mm, SIZE)
    if mismatch_deg(DIGIT, light, x_mm, y_mm) < MATCH_DEG:
        assert found == Orientation()
    else:
        assert found is not None and found == orientation


def test_the_directions_may_be_off_by_less_than_the_limit():
    for degrees, expected in ((MATCH_DEG - 5, Orientation()), (-MATCH_DEG + 5, Orientation())):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turned = light_of(DIGIT, 0, 0) @ np.array([[c, s], [-s, c]])
        assert recognise(turned, 0, 0, SIZE) == expected


@pytest.mark.parametrize("size", [(320, 320), (320, 240), (200, 320)])
def test_images_of_other_proportions_are_of_no_digit(size):
    assert recognise(light_of(DIGIT, 0, 0), 0, 0, size) is None


def test_other_directions_are_of_no_digit():
    assert recognise(np.full((3, 2), 50.0), 0, 0, SIZE) is None, "all lights on one side"
    a = np.radians([0, 180, 200])
    assert recognise(80 * np.stack([np.cos(a), np.sin(a)], -1), 0, 0, SIZE) is None, "two opposite"
    rng = np.random.default_rng(0)
    found = [recognise(rng.normal(size=(3, 2)), 0, 0, SIZE) for _ in range(400)]
    assert np.mean([f is not None for f in found]) < 0.1


def noisy(image, rng):
    """As another unit of the make shows it: brighter, with a tilt of its own and noise."""
    h, w, _ = image.shape
    y, x = np.mgrid[:h, :w] / np.array([h, w])[:, None, None] - 0.5
    image = 1.15 * image + 12 + (18 * x + 14 * y)[..., None] + rng.normal(0, 4, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("orientation", orientations(), ids=str)
def test_a_rest_image_tells_the_make_and_which_way_round_it_is(orientation):
    image = noisy(rest_image((320, 240, 3)), np.random.default_rng(0))
    found, alike = recognise_rest(np.ascontiguousarray(orientation.shown(image)))
    assert found == orientation and alike > LIKE


def test_other_rest_images_are_of_no_digit():
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:320, :240] / 320 - 0.5
    grey = np.full((320, 240, 3), 120, np.uint8)
    around = np.stack([np.hypot(x, y)] * 3, -1) * [250, 240, 230]
    for image in (grey, noisy(around, rng), rng.integers(0, 255, (320, 240, 3)).astype(np.uint8)):
        assert recognise_rest(image)[0] is None
    assert recognise_rest(rest_image((320, 320, 3)))[0] is None, "of other proportions"


def test_real_rest_images_are_told():
    folder = Path(os.environ.get("PNEUTAC_DATA", "")) / "tactile"
    if not os.environ.get("PNEUTAC_DATA") or not folder.is_dir():
        pytest.skip("PNEUTAC_DATA does not name a folder with real recordings")
    found = {}
    for name in ("digit_nagoya", "digit_fots", "gelsight_thu"):
        meta = json.loads((folder / name / "recording.json").read_text())
        rest = np.asarray(Image.open(folder / name / meta["rest_image"]).convert("RGB"))
        found[name] = recognise_rest(rest)[0]
    assert found == {"digit_nagoya": Orientation(), "digit_fots": Orientation(), "gelsight_thu": None}


SQUARE = Outline(((-2, -2), (2, -2), (2, 2), (-2, 2)))


def test_a_square_outline_is_a_cube_on_its_face():
    for yaw in (0.0, 0.6):
        plain = Press("cube", 4.0, 1.0, -2.0, 0.5, yaw)
        punch = Press("outline", 0.0, 1.0, -2.0, 0.5, yaw, SQUARE)
        np.testing.assert_allclose(punch.depths(), plain.depths(), atol=1e-6)
        assert punch.contact_radius_mm == pytest.approx(plain.contact_radius_mm)


def test_a_leaning_punch_is_deeper_on_the_side_that_it_leans_to():
    lean = {"tilt_x_rad": 0.04, "tilt_y_rad": -0.03}
    cube = Press("cube", 4.0, 1.0, -2.0, 0.5, 0.6, **lean).depths()
    punch = Press("outline", 0.0, 1.0, -2.0, 0.5, 0.6, SQUARE, **lean).depths()
    upright = Press("cube", 4.0, 1.0, -2.0, 0.5, 0.6).depths()
    x, y = np.meshgrid((np.arange(59) + 0.5) * 12 / 59 - 7, (np.arange(80) + 0.5) * 16 / 80 - 6)
    wanted = np.where(upright > 0, 0.5 + np.tan(0.04) * x - np.tan(0.03) * y, 0)
    assert np.ptp(wanted[upright > 0]) > 0.15
    np.testing.assert_allclose(punch, wanted, atol=1e-6)
    assert np.median(np.abs(cube - punch)[upright > 0]) < 1e-3 and ((cube > 0) != (punch > 0)).mean() < 0.002


def test_a_mesh_of_a_ball_is_a_ball():
    ball = Figure(trimesh.creation.icosphere(4, 3.0).triangles + [0.0, 0.0, 40.0])
    plain, mesh = Press("sphere", 3.0, -1.0, 2.0, 0.8), Press("mesh", 0.0, -1.0, 2.0, 0.8, 0.3, ball)
    np.testing.assert_allclose(mesh.depths(), plain.depths(), atol=0.012)
    assert mesh.contact_radius_mm == pytest.approx(np.sqrt(0.8 * (6 - 0.8)), rel=0.05)
    assert mesh.size_mm == pytest.approx(3.0, rel=1e-3)


METRES = trimesh.creation.box((0.004, 0.004, 0.004)).triangles


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Outline.of_text("0 2; 2 -1"), "three corners"),
        (lambda: Outline.of_text("triangle"), "give corners in mm"),
        (lambda: Outline.of_text("-2 -2; 2 2; 2 -2; -2 2"), "crosses itself: side 1 meets side 3"),
        (lambda: Outline.of_text("1 1; 3 1; 2 3"), "does not contain its origin"),
        (lambda: Figure(METRES), "give it in mm"),
        (lambda: Figure(1e3 * METRES + [9.0, 0, 0]), "does not contain its origin"),
        (lambda: Press("mesh", 3.0, 0, 0, 0.5), "needs a figure"),
        (lambda: Press("cube", 3.0, 0, 0, 0.5, 0, SQUARE), "has no figure"),
        (lambda: Press("outline", 0, 0, 0, 0.5, 0, SQUARE).shapes(), "none of the shapes"),
    ],
)
def test_impossible_indenters_get_one_sentence(make, says):
    with pytest.raises(InputError, match=says) as e:
        make()
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("mesh", [False, True])
def test_the_distances_for_material_points_are_those_of_a_box(mesh):
    box = Figure(trimesh.creation.box((4, 4, 40)).triangles) if mesh else SQUARE
    table = distances_m(box)
    line = np.linspace(-1, 1, len(table)) * half_edge_m(box)
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3) + centre_m(box)
    known = signed_distance(6, np.array([2e-3, 2e-3, 20e-3]), points - [0, 0, 20e-3])
    assert np.abs(table.ravel() - known).max() < (1e-4 if mesh else 1e-9)


CREEP = {"late_4s": 0.05, "late_20s": 0.1, "late_100s": 0.05}
LONG, SHORT = Press("sphere", 3.0, -2.5, -3.0, 0.9), Press("sphere", 3.0, 3.0, 4.0, 0.4)


@pytest.fixture
def creeping(linear):
    return replace(linear, effects={"gel_creep": CREEP})


def test_a_longer_hold_leaves_more_and_a_longer_wait_less():
    branches = [(0.1, 10.0)]
    assert share_left(branches, 0.0, 1.0) == 0
    assert share_left(branches, 1e6, 0.0) == pytest.approx(0.1)
    assert share_left(branches, 10.0, 10.0) == pytest.approx(0.1 * (1 - np.exp(-1)) * np.exp(-1))


def test_a_press_lies_on_its_indenter_whatever_was_left(creeping):
    cell = creeping.window_mm[0] / COLS, creeping.window_mm[1] / ROWS
    over = replace(LONG, x_mm=LONG.x_mm + 1.0, depth_mm=0.5)
    (left,) = Residues(creeping, [[Earlier(LONG, 60.0, 3.0)]]).surfaces(creeping)
    held = surface(press_depth(LONG, creeping), cell, creeping.decay_mm)
    np.testing.assert_allclose(left, held * share_left([(0.05, 4), (0.1, 20), (0.05, 100)], 60, 3), rtol=1e-5)
    depth = press_depth(over, creeping)
    u = pressed_on(depth, left, cell, creeping.decay_mm)
    assert u.max() == pytest.approx(depth.max(), abs=1e-3) and (u >= depth - 1e-3).all()
    assert (u >= left).all() and u[depth == 0].max() < depth.max()


def test_a_simulator_remembers_as_the_photographs_do(creeping):
    memory, held = Memory(branches_of(creeping)), np.zeros((ROWS, COLS))
    held[30:50, 20:40] = 0.9
    assert memory.left_mm(0.0) is None
    memory.hold(held)
    for t in np.arange(0.0, 60.0, 2.5):
        memory.left_mm(t)
    memory.left_mm(60.0)
    memory.hold(None)
    left = memory.left_mm(63.0)
    np.testing.assert_allclose(left, held * share_left(branches_of(creeping), 60.0, 3.0), rtol=1e-5)
    assert memory.left_mm(0.0) is None, "a new episode begins at rest"


def test_nothing_changes_where_nothing_is_told_or_left(creeping, linear):
    old = [Earlier(LONG, 60.0, 1e5)]
    for gel, earlier in ((creeping, ()), (creeping, old), (linear, [Earlier(LONG, 60.0, 3.0)])):
        image = Predictor(gel).image(SHORT, gel.rest_image, 0.0, earlier)
        np.testing.assert_array_equal(image, Predictor(linear).image(SHORT, linear.rest_image))
    seen = Predictor(creeping).image(SHORT, linear.rest_image, 0.0, [Earlier(LONG, 60.0, 3.0)])
    assert np.abs(seen - Predictor(linear).image(SHORT, linear.rest_image).astype(float)).max() > 4


def photographs(gel):
    """Each ball held a minute, then one held shortly; some far from each other, some not."""
    out, before, clock = [], [], 0.0
    for k, (x, y) in enumerate([(-3, -5), (3, 4), (3, -4), (-3, 4), (0, 0), (3, 5), (-3, 0), (2, -5)]):
        hold = 2.0 if k % 2 else 60.0
        press = Press("sphere", 3.0, x, y, 0.5 if k % 2 else 0.9)
        clock += 3.0 + hold
        earlier = tuple(Earlier(p, held, clock - at) for p, held, at in before)
        image = Predictor(gel).image(press, gel.rest_image, 0.0, earlier).astype(float)
        image += np.random.default_rng(k).standard_normal(image.shape)
        image = image.clip(0, 255).round().astype(np.uint8)
        out.append(PressPhotograph(press, image, gel.rest_image, earlier=earlier))
        before.append((press, hold, clock))
    return out


def test_the_shares_are_found_in_a_session_and_stay_where_no_press_came_before(creeping, linear):
    def fitted(start, seen):
        return fit_photographs(start, seen, ["gel_creep"], makes=()).gel.effects["gel_creep"]

    def left(values):
        return share_left(get_effect("gel_creep").late(values), 60.0, 3.0)

    found = fitted(linear, photographs(creeping))
    assert found == pytest.approx(CREEP, rel=0.25), "none of it is taken for drift of the light"
    assert left(found) == pytest.approx(left(CREEP), rel=0.15)
    assert fitted(creeping, [replace(p, earlier=()) for p in photographs(linear)[:1]]) == CREEP
    assert left(fitted(linear, photographs(linear))) < 0.01


def test_a_generated_recording_that_hides_creep_tells_its_holds_and_is_predicted(tmp_path):
    recording = write_hidden_gel(tmp_path / "recording", ["gel_creep"], seed=1, images=4)
    data = GelRecording.load(recording)
    assert recording.samples["hold_s"].tolist() == [60.0, 2.0, 60.0, 2.0] and data.samples[1].earlier
    gel, last = GelModel.builtin(), data.samples[1]
    gel.effects = json.loads((tmp_path / "truth" / "recording.json").read_text())
    errors = [
        rmse(Predictor(gel).image(last.press, last.rest, last.clock, earlier), last.image)
        for earlier in (last.earlier, ())
    ]
    assert errors[0] < 0.9 * errors[1]


CELL = 12 / 59, 16 / 80


@pytest.mark.parametrize(
    ("there", "share"), [(True, 0.8), pytest.param(False, 1.05, marks=pytest.mark.nightly)]
)
def test_five_presses_teach_what_the_model_leaves_over_and_no_harm_if_nothing(
    there, share, linear, photograph, session
):
    linear.effects = {"rest_colour": {f"exponent_{c}": 0.7 for c in CHANNELS}}
    truth = replace(linear, residual=wavy(np.random.default_rng(1)) if there else None)
    gel = fit_presses(session(truth, 5), 20.0, ["rest_colour"], makes=()).gel
    assert gel.residual is not None or not there
    press = Press("sphere", 3.0, 0.5, 2.0, 0.8)
    real, bare = photograph(truth, press), replace(gel, residual=None)
    own, without = (rmse(Predictor(g).image(press, linear.rest_image), real) for g in (gel, bare))
    assert own < share * without


def test_it_adds_what_its_formula_says(linear):
    field, u = wavy(np.random.default_rng(6)), np.zeros((80, 59), np.float32)
    u[20:60, 10:40] = np.random.default_rng(7).uniform(0, 1.2, (40, 30))
    rows = linear.coefficients
    added = levels([field], u, CELL, [cast(u, *CELL, row) for row in rows])
    share = np.minimum(u / MOVED_MM, 1) * (u > LEAST_MM)
    for k, row in enumerate(rows):
        z = features(u, CELL, row)
        np.testing.assert_allclose(z[..., :2] * SLOPE, np.stack(gradient(u, CELL), -1), atol=1e-5)
        expected = field.at(k, z.reshape(-1, FEATURES)).reshape(u.shape)
        np.testing.assert_allclose(added[k], share * expected, atol=2e-3)


def test_it_adds_the_same_levels_where_the_rest_image_is_bright_and_where_it_is_dark(linear):
    field = wavy(np.random.default_rng(4))
    linear.rest_image[:, :120], linear.rest_image[:, 120:] = 60, 120
    u = np.full((80, 59), 0.3, np.float32)
    added = []
    for exponent in (0.0, 1.5):
        effects = {"rest_colour": {f"exponent_{c}": exponent for c in CHANNELS}}
        gel = replace(linear, effects=effects, residual=field)
        with_it, without = (
            light(u, CELL, *g.lighting).transpose(1, 2, 0) for g in (gel, replace(gel, residual=None))
        )
        w = gel.weight_on(to_grid(linear.rest_image))
        added.append(w * (with_it - without))
    assert np.ptp(w) > 0.5 and np.abs(added[0]).max() > 1
    np.testing.assert_allclose(added[1], added[0], atol=1e-3)


@pytest.mark.parametrize(
    ("agreement", "low", "high"), [(1.0, 0.8, 1.0), (0.5, 0.3, 0.5), (0.0, 0, 0.2), (-1.0, 0, 0)]
)
def test_as_much_of_it_is_taken_as_presses_bear_out_that_it_was_not_learnt_from(agreement, low, high):
    rng, tried = np.random.default_rng(5), []
    for _ in range(5):
        field, z = wavy(rng), rng.normal(0, 0.7, (3, 300, FEATURES))
        one = Leftover(z, np.ones((3, 300)), np.zeros((3, 300)), np.ones(300, bool))
        own = wavy(rng)  # what this press has for itself
        one.levels = agreement * one.added(field) + 0.2 * one.added(own)
        tried.append((field, one))
    assert low <= trusted_share(tried) <= high


def test_a_field_of_other_shapes_is_refused():
    with pytest.raises(InputError, match=r"residual field must be finite numbers of shapes \(3, n, 7\)"):
        ResidualField(np.zeros((3, 4, 6)), np.zeros((3, 4)))
    with pytest.raises(InputError, match="calibrate the gel again"):
        ResidualField(np.full((3, 4, FEATURES), np.nan), np.zeros((3, 4)))


needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
PRESSES = (
    Press("sphere", 3.0, 0.5, 0.5, 0.9),
    Press("sphere", 2.0, 0.05, 0.9, 1.4),  # over the gel's rim
    Press("cube", 2.0, 0.3, 0.6, 0.7),
)


def gels() -> dict[str, GelModel]:
    plain = GelModel.builtin()
    prior = layout.DIGIT.prior_field(plain.rest_image, layout.Orientation()).times(20)
    shadow = {f"shadow_{c}_levels": 60.0 for c in ("red", "green", "blue")}
    shadow |= {"elevation_red": 0.2, "elevation_green": 0.3, "elevation_blue": 0.1, "edge_mm": 0.1}
    shadow["shadow_blue_levels"] = 0.0
    near = {"near_light": {"distance_red_mm": 9.0, "distance_green_mm": 12.0, "distance_blue_mm": 8.5}}
    return {
        "generated": plain,
        "linear": replace(plain, effects={}, depth_scale=0.8),
        "shadows": replace(plain, effects=plain.effects | {"shadow": shadow}),
        "lights above the gel": replace(plain, effects=plain.effects | near | {"shadow": shadow}),
        "prior field": replace(plain, prior_residual=prior, effects=plain.effects | {"shadow": shadow}),
        "two fields": replace(plain, prior_residual=prior, residual=prior.times(-0.5)),
        "wide cells": replace(plain, px_per_mm=12.0),
    }


GELS = gels()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=needs_cuda)])
@pytest.mark.parametrize("name", GELS)
def test_a_batch_is_what_the_sensor_draws_one_by_one(name, device):
    gel = GELS[name]
    depth = np.stack([press_depth(p, gel) for p in PRESSES] + [np.zeros((80, 59), np.float32)])
    sensor, many = TactileSensor(gel), TactileBatch(gel, device)
    for again in range(2):  # the second from what was recorded
        images = many.image(depth).cpu().numpy()
        off = np.abs(images.astype(int) - np.stack([sensor.image(d) for d in depth]))
        assert images.dtype == np.uint8
        assert off.max() <= 1, again
        assert np.mean(off > 0) < 1e-3
    assert (images[:3] != gel.rest_image).any((1, 2, 3)).all()


def test_no_probe_grids_make_no_images_and_those_of_another_shape_are_refused():
    batch = TactileBatch(device="cpu")
    assert batch.image(np.zeros((0, 80, 59))).shape == (0, 320, 240, 3)
    with pytest.raises(ValueError, match=r"probe grids have shape \(B, 80, 59\); got \(80, 59\)"):
        batch.image(np.zeros((80, 59)))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_missing_device_is_told():
    with pytest.raises(InputError, match="PyTorch finds no CUDA device; give device='cpu'"):
        TactileBatch(device="cuda")
