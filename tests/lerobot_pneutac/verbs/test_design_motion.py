"""`pneutac design` of demonstrations: which motion of the arm tells what."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from verbs import refused

from lerobot_pneutac import InputError, Twin, design_motion, load_demonstrations
from lerobot_pneutac.verbs.design_motion import (
    COMPLIANCE,
    FRICTION,
    PLAIN,
    PRESS,
    Misses,
    Response,
    World,
    carried_out,
    fingers,
    sideways,
)
from lerobot_robot_pneutac.standin.world import Physics, StandinWorld

DEMOS = Path(__file__).parents[2] / "golden" / "recordings" / "demos"


def felt(force, turn=0.0):
    way = np.linspace(-6.0, 6.0, 50)
    return Response(np.asarray(force, float), turn * way, way)


def test_a_level_tells_only_where_one_is_known_and_more_episodes_tell_shapes_better():
    flat, half, late = np.ones(50), np.full(50, 0.8), 1 - 0.05 * np.exp(-np.arange(50) / 10)
    few, many, blind = Misses.of(4, True), Misses.of(16, True), Misses.of(16, False)
    levels = [m.levelled(felt(flat), felt(half)) for m in (few, many)]
    assert levels[0] == pytest.approx(levels[1]) and levels[0] > 3
    assert blind.levelled(felt(flat), felt(half)) == 0
    assert blind.shaped(felt(flat), felt(half)) == pytest.approx(0, abs=1e-9)
    shapes = [m.shaped(felt(flat), felt(late)) for m in (few, many)]
    turns = [m.turned(felt(flat, 0.7), felt(flat, 0.3)) for m in (few, many)]
    assert shapes[1] == pytest.approx(2 * shapes[0]) and turns[1] == pytest.approx(2 * turns[0])


@pytest.mark.slow
def test_the_stand_in_shows_what_the_twin_foresees():
    """Built otherwise; of one stiffness. A finger of 70 % presses with a fifth to a quarter less force."""
    plain, softer = (
        StandinWorld("button", touch="none", physics=p) for p in (Physics(), Physics(stiffness=0.7))
    )
    force = [carried_out(w, 3, PRESS).force_n.mean() for w in (plain, softer)]
    foreseen = [
        carried_out(World("button", t, "none", sideways=True), 3, PRESS).force_n.mean()
        for t, _ in (fingers(Twin.builtin())[k] for k in (PLAIN, COMPLIANCE))
    ]
    assert force[1] / force[0] == pytest.approx(foreseen[1] / foreseen[0], abs=0.07)
    drag = sideways(12.0)
    turns = [
        carried_out(
            StandinWorld("button", touch="none", physics=Physics(friction=f)), 3, drag
        ).turn_deg_per_mm
        for f in (1.0, 0.5)
    ]
    assert turns[1] < 0.5 * turns[0]


@pytest.mark.nightly
def test_it_says_which_motions_to_record(tmp_path):
    shown = load_demonstrations(DEMOS)
    result = design_motion(Twin.builtin(), replace(shown, episodes=6 * shown.episodes))
    assert "Record 12 episodes with the finger against the bar of 'button'" in result.sentence
    assert "was fitted to no demonstrations of 'button'" in result.remarks()[0]
    assert "drag sideways" in result.chosen[FRICTION].motion.name and COMPLIANCE not in result.chosen
    page = result.report(tmp_path)
    assert json.loads((tmp_path / "result.json").read_text())["chosen"].keys() == result.chosen.keys()
    assert "turn of the imprint" in page.read_text()


@pytest.mark.parametrize("option", ["diagnosis", "hands"])
def test_what_motions_do_not_take_is_said(tmp_path, option):
    twin = Twin.builtin().save(tmp_path / "twin")
    refused(f"^{option}:? .* leave it out", "design", f"--{option}={tmp_path}", twin=twin, recording=DEMOS)


def test_a_body_of_several_chambers_is_refused():
    from arms import arm_twin

    with pytest.raises(InputError, match="has 3 chambers"):
        design_motion(arm_twin(), load_demonstrations(DEMOS))
