"""Episodes of the independent stand-in, replayed in the twin's world.

How imprints turn while a finger is dragged tells whether its gel sticks.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from demonstration_sets import write_demonstrations
from played import episode_of, played, shown

from lerobot_pneutac.verbs.compare_demonstrations import TOUCHED_MM
from lerobot_robot_pneutac.standin.world import Physics, StandinWorld
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.imprint import (
    Dragging,
    find_place,
    light_drift,
    rest_image,
    strengths,
    turn_deg_per_mm,
    turns_deg,
)
from pneutac_datasets.demonstrations.reading import (
    Demonstrations,
    checked,
    is_dataset,
    load_demonstrations,
)
from pneutac_datasets.demonstrations.replaying import late, replay
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, AREA, CONTROL_HZ, EE, PRESSURE, state_names
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World


@pytest.fixture(scope="module")
def episode():
    return recorded(CONTROL_HZ)


def recorded(control_hz: int) -> Episode:
    """Five seconds on the stand-in."""
    world = StandinWorld("button", station=Station(control_hz=control_hz))
    return episode_of(*played(world, 2, steps=5 * control_hz), control_hz)


@pytest.fixture(scope="module")
def world():
    return World("button", Twin.builtin(), "probe", "probe")


def test_the_flange_goes_where_it_went_and_its_object_is_met_when_it_was(world, episode):
    place = find_place(world, episode)
    replayed = replay(world, episode, place)
    off_mm = 1e3 * np.linalg.norm(replayed.flange_m - episode.state[:, EE], axis=1)
    assert np.median(off_mm) < 0.5
    onset, felt = episode.contact()[0], np.flatnonzero(replayed.press_mm > TOUCHED_MM)
    assert abs(felt[0] - onset) < 0.4 * CONTROL_HZ
    away = replay(world, episode)
    assert away.press_mm.max() < 0.05


def test_commands_act_as_late_as_they_are_said_to():
    command = np.arange(1.0, 9.0)
    np.testing.assert_allclose(late(command, 0.0), command)
    np.testing.assert_allclose(late(command, 2 / CONTROL_HZ), [0, 0, 1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(late(command, 0.5 / CONTROL_HZ), [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5])


def test_an_imprint_grows_with_the_press_and_a_drift_of_light_makes_none(episode):
    rest = rest_image(episode)
    strength = strengths(episode.images, rest)
    onset = episode.contact()[0]
    assert strength[: onset - 8].max() < 1e-3 < 0.1 < strength[onset + 12 :].max()
    brighter = np.clip(rest * 1.03, 0, 255).astype(np.uint8)
    assert strengths(brighter[None], rest)[0] < 1e-3
    pressed, drift = episode.images[onset + 12 :], np.array([1.03, 1.0, 0.98])
    drifted = np.clip(pressed * drift, 0, 255).round().astype(np.uint8)
    np.testing.assert_allclose(strengths(drifted, rest), strengths(pressed, rest), rtol=0.1)


def test_a_drift_of_the_light_is_reported(episode):
    rest = rest_image(episode)
    assert not light_drift([episode], rest).drifted
    red = np.clip(episode.images * np.array([1.15, 1.0, 1.0]), 0, 255).astype(np.uint8)
    drift = light_drift([replace(episode, images=red)], rest)
    assert drift.drifted and drift.gain[0] == pytest.approx(1.15, abs=0.02)
    assert drift.gain[1] == pytest.approx(1.0, abs=0.01)


def test_a_drifted_light_is_no_touch(episode):
    state, onset = episode.state.copy(), episode.contact()[0]
    state[:, AREA] = 0.9
    red = np.clip(episode.images * np.array([1.15, 1.0, 1.0]), 0, 255).astype(np.uint8)
    given = checked(Demonstrations(Path("demos"), "button", [replace(episode, state=state, images=red)]))
    assert "1 of 1 episodes begin with contact_area.pos above 0" in given.warnings[0]
    assert abs(given.episodes[0].contact()[0] - onset) < 0.4 * CONTROL_HZ


@pytest.mark.parametrize(
    ("rows", "places", "change", "says"),
    [
        (
            slice(None),
            PRESSURE,
            lambda x: 0.0,
            "in episode 1 pressure.pos stays at 0 kPa while the",
        ),
        (slice(None), AREA, lambda x: 0.0, "episode 1 never touches anything"),
        (slice(40, None), EE, lambda x: x + [0.1, 0, 0], "in episode 1 the flange jumps by 10. mm at 2.6 s"),
    ],
)
def test_what_cannot_serve_is_refused(episode, rows, places, change, says):
    state = episode.state.copy()
    state[rows, places] = change(state[rows, places])
    with pytest.raises(InputError, match=says):
        checked(Demonstrations(Path("demos"), "button", [episode, replace(episode, state=state)]))


def test_another_rate_tells_the_same(world):
    """Of 30 frames a second every other is seen, and commands add up to the same way; touch comes then."""
    fast = recorded(30)
    slow = fast.resampled(CONTROL_HZ)
    assert len(slow) == len(fast) / 2 and slow.resampled(CONTROL_HZ) is slow
    np.testing.assert_allclose(slow.state, fast.state[::2])
    way = [np.cumsum(e.action[:, :3], 0) / e.fps for e in (slow, fast)]
    np.testing.assert_allclose(way[0], way[1][1::2], atol=1e-9)
    place = find_place(world, slow)
    replayed = replay(world, slow, place)
    assert np.median(1e3 * np.linalg.norm(replayed.flange_m - slow.state[:, EE], axis=1)) < 0.5
    felt = np.flatnonzero(replayed.press_mm > TOUCHED_MM)
    assert abs(felt[0] / CONTROL_HZ - fast.contact()[0] / fast.fps) < 0.4


def test_a_folder_that_is_not_there_is_no_name_on_the_hub(tmp_path):
    assert not is_dataset(tmp_path / "nothing") and not is_dataset("tests/nothing")
    assert is_dataset("user/demonstrations")


def test_a_dataset_of_another_arm_is_refused_before_any_work(tmp_path):
    six = write_demonstrations(tmp_path / "six", names=state_names(6))
    with pytest.raises(InputError, match="the arm has 6 joints, and that of the station 7; give the station"):
        load_demonstrations(six)


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


def test_it_is_reported_of_drags_alone_and_kept_by_task():
    still = dragged(0.6)
    still.action[:] = 0
    assert turn_deg_per_mm(still) is None
    assert Dragging.of([dragged(0.6), dragged(0.6), still]) is None
    kept = Dragging(0.5, 0.05, 8)
    history = [{"version": 0}, {"dragging": kept.to_history("button")}, {"version": 2}]
    assert Dragging.known(history, "button") == kept and Dragging.known(history, "switch") is None


@pytest.mark.nightly
def test_half_the_friction_of_the_stand_ins_gel_is_reported_from_a_softer_finger():
    def read(seed, **hidden):
        return Dragging.of(shown(8, seed, Physics(**hidden), drag_m=0.012, steps=525))

    known = read(0)
    assert read(1000, friction=0.5).slips(known)
    assert not read(2000).slips(known) and not read(3000, stiffness=0.7).slips(known)
