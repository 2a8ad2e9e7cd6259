"""What earlier presses leave in a gel that creeps."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pneutac_datasets.generate.hidden_gel import write_hidden_gel
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.effects import get_effect
from pneutac_sim.effects.gel_creep import share_left
from pneutac_sim.gel.fit import fit_photographs
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.late import Earlier, Memory, branches_of, pressed_on
from pneutac_sim.gel.metrics import rmse
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import Predictor, PressPhotograph, Residues, press_depth
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.surface import surface

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
        out.append(
            PressPhotograph(
                press, image.clip(0, 255).round().astype(np.uint8), gel.rest_image, earlier=earlier
            )
        )
        before.append((press, hold, clock))
    return out


def test_the_shares_are_found_in_a_session_and_stay_where_no_press_came_before(creeping, linear):
    found = fit_photographs(linear, photographs(creeping), ["gel_creep"], makes=()).gel.effects["gel_creep"]
    three = [share_left(get_effect("gel_creep").late(v), 60.0, 3.0) for v in (found, CREEP)]
    assert three[0] == pytest.approx(three[1], rel=0.15)
    alone = [replace(p, earlier=()) for p in photographs(linear)[:1]]
    kept = fit_photographs(creeping, alone, ["gel_creep"], makes=()).gel.effects["gel_creep"]
    assert kept == CREEP
    none = fit_photographs(linear, photographs(linear), ["gel_creep"], makes=()).gel.effects["gel_creep"]
    assert share_left(get_effect("gel_creep").late(none), 60.0, 3.0) < 0.01


def test_a_generated_recording_that_hides_creep_tells_its_holds_and_is_predicted(tmp_path):
    recording = write_hidden_gel(tmp_path / "recording", ["gel_creep"], seed=1, images=4)
    data, truth = (
        GelRecording.load(recording),
        json.loads((tmp_path / "truth" / "recording.json").read_text()),
    )
    assert recording.samples["hold_s"].tolist() == [60.0, 2.0, 60.0, 2.0] and data.samples[1].earlier
    gel, last = GelModel.builtin(), data.samples[1].photograph
    gel.effects = truth
    errors = [
        rmse(Predictor(gel).image(last.press, last.rest, last.clock, earlier), last.image)
        for earlier in (last.earlier, ())
    ]
    assert errors[0] < 0.9 * errors[1]
