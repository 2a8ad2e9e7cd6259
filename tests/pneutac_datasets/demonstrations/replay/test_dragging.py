"""How imprints turn while a finger is dragged tells whether its gel sticks."""

import numpy as np
import pytest

from lerobot_robot_pneutac.standin.world import Physics, StandinWorld
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.replay.dragging import Dragging, turn_deg_per_mm
from pneutac_datasets.demonstrations.replay.imprint import turns_deg
from pneutac_sim.features import ACTION_NAMES, CONTROL_HZ
from pneutac_sim.world.expert import ScriptedExpert

SHAPE = (120, 160)
BEGUN = 20  # frames without touch


def imprint(turn_deg):
    """A gel with a bright bar that is turned by so much."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    a = np.radians(turn_deg)
    across = -(columns - 80) * np.sin(a) + (rows - 60) * np.cos(a)
    along = (columns - 80) * np.cos(a) + (rows - 60) * np.sin(a)
    bar = 40 * np.exp(-((across / 6) ** 2)) * (np.abs(along) < 45)
    return np.clip(100 + bar[..., None] * np.ones(3), 0, 255).astype(np.uint8)


def dragged(turn_per_mm, sticks_mm=np.inf):
    """An episode that is dragged to and fro by 10 mm; beyond `sticks_mm` its gel slips."""
    drag = np.concatenate([np.full(15, 0.01), np.full(30, -0.01), np.full(30, 0.01), np.full(15, -0.01)])
    speed = np.concatenate([np.zeros(BEGUN + 10), drag, np.zeros(5)])
    way = np.concatenate([[0.0], np.cumsum(speed)[:-1]]) / CONTROL_HZ
    held, turned = 0.0, []
    for y in 1e3 * way:
        held = np.clip(held, y - sticks_mm, y + sticks_mm)
        turned.append(turn_per_mm * (y - held))
    state, action = np.zeros((len(way), 20)), np.zeros((len(way), 4))
    state[:, -5], action[:, ACTION_NAMES.index("dy.vel")] = way, speed
    state[BEGUN:, -3] = 0.05
    images = np.stack([imprint(0) * 0 + 100] * BEGUN + [imprint(t) for t in turned[BEGUN:]])
    return Episode(state, action, images.astype(np.uint8), "press", CONTROL_HZ)


@pytest.mark.parametrize("turn", [-20.0, 0.0, 7.0])
def test_the_turn_of_an_imprint_is_read(turn):
    rest = np.full((*SHAPE, 3), 100, np.uint8)
    shown = turns_deg(np.stack([imprint(turn), rest]), rest)
    assert shown[0] == pytest.approx(turn, abs=0.5) and np.isnan(shown[1])


def test_a_gel_that_slips_turns_less_than_one_that_sticks():
    sticks, slips = (Dragging.of([dragged(t, s) for t in (0.5, 0.6, 0.7)]) for s in (np.inf, 1.0))
    assert sticks.turn_deg_per_mm == pytest.approx(0.6, rel=0.2)
    assert slips.slips(sticks) and not sticks.slips(sticks) and not sticks.slips(slips)
    assert "less friction than before" in slips.sentence(sticks)
    assert "no loss of friction" in sticks.sentence(sticks)
    fewer = Dragging(0.4, 0.03, 8)
    assert fewer.less(Dragging(0.5, 0.03, 8)) and not fewer.less(Dragging(0.45, 0.03, 8))
    assert "sticks less than before" in fewer.sentence(Dragging(0.5, 0.03, 8))
    assert "`pneutac calibrate` stores that" in sticks.sentence(None)


def test_it_is_told_of_drags_alone_and_kept_by_task():
    still = dragged(0.6)
    still.action[:] = 0
    assert turn_deg_per_mm(still) is None
    assert Dragging.of([dragged(0.6), dragged(0.6), still]) is None
    kept = Dragging(0.5, 0.05, 8)
    history = [{"version": 0}, {"dragging": kept.kept("button")}, {"version": 2}]
    assert Dragging.known(history, "button") == kept and Dragging.known(history, "switch") is None


@pytest.mark.nightly
def test_half_the_friction_of_the_stand_ins_gel_is_told_from_a_softer_finger():
    def read(seed, **hidden):
        world, episodes = StandinWorld("button", physics=Physics(**hidden)), []
        world.task.drag_m = 0.012
        while len(episodes) < 8:
            seen, actions = [world.reset(seed)], []
            expert = ScriptedExpert(world, np.random.default_rng(seed))
            seed += 1
            while len(actions) < 525 and not (world.success or world.failure):
                actions.append(expert.action())
                seen.append(world.step(actions[-1]))
            if world.success:
                state = np.array([o.state for o in seen[:-1]], float)
                images = np.stack([o.tactile for o in seen[:-1]])
                episodes.append(Episode(state, np.array(actions, float), images, "press", CONTROL_HZ))
        return Dragging.of(episodes)

    known = read(0)
    assert read(1000, friction=0.5).slips(known)
    assert not read(2000).slips(known) and not read(3000, stiffness=0.7).slips(known)
