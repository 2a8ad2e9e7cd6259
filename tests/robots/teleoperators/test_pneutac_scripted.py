from weakref import WeakSet

import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pneutac.robots import pneutac_sim
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators import pneutac_scripted
from lerobot_robot_pneutac.teleoperators.config_pneutac_scripted import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, ACTION_NAMES, CONTROL_HZ, DEMONSTRATION_S


@pytest.fixture
def pair(tmp_path):
    """A connected robot and a function that makes a connected teleoperator; LeRobot connects it first."""
    robot = PneutacSim(PneutacSimConfig(id="sim", calibration_dir=tmp_path, seed=3))

    def teleoperator(**kwargs) -> PneutacScripted:
        teleop = PneutacScripted(PneutacScriptedConfig(id="script", calibration_dir=tmp_path, **kwargs))
        teleop.connect()
        if not robot.is_connected:
            robot.connect()
        return teleop

    yield robot, teleoperator
    if robot.is_connected:
        robot.disconnect()


def run(robot, teleop, ticks) -> list[dict]:
    actions = []
    for _ in range(ticks):
        robot.get_observation()
        actions.append(teleop.get_action())
        robot.send_action(actions[-1])
    return actions


@pytest.fixture(autouse=True)
def still_clock(monkeypatch):
    """This computer's own delays are no missed ticks."""
    now = [0.0]
    monkeypatch.setattr(pneutac_scripted, "clock", lambda: now[0])
    return now


def test_ticks_that_are_missed_do_not_shift_the_episodes(pair, still_clock):
    robot, teleoperator = pair
    teleop = teleoperator(episode_steps=30, reset_steps=15)
    for _ in range(3):  # as LeRobot: by the clock 2 s an episode, 1 s of waiting, then a while of saving
        actions = []
        for _ in range(30):
            robot.get_observation()
            actions.append(teleop.get_action())
            robot.send_action(actions[-1])
            still_clock[0] += 0.101
        assert [i for i, a in enumerate(actions) if a.get("reset")] == [25]
        moved = [any(a[name] for name in ACTION_NAMES) for a in actions]
        assert all(moved[:20]) and not any(moved[20:])
        still_clock[0] += 1.7


@pytest.mark.parametrize(("reset_steps", "tick"), [(0, 3), (1, 4), (15, 11)])
def test_scene_is_reset_once_a_cycle_and_outside_the_demonstration(pair, reset_steps, tick):
    robot, teleoperator = pair
    cycle = 4 + reset_steps
    actions = run(robot, teleoperator(episode_steps=4, reset_steps=reset_steps), 2 * cycle)
    assert [i for i, a in enumerate(actions) if a.get("reset")] == [tick, tick + cycle]
    assert len(robot.successes) == 2


def test_demonstrations_do_the_task_within_limits(pair):
    robot, teleoperator = pair
    steps = DEMONSTRATION_S * CONTROL_HZ
    actions = run(robot, teleoperator(episode_steps=steps, seed=5), 4 * steps)
    assert sum(robot.successes) >= 3
    values = np.array([[a[name] for name in ACTION_NAMES] for a in actions], np.float32)
    assert ((values >= ACTION_LOW) & (values <= ACTION_HIGH)).all()
    # No two people, and no two tries of one, are alike.
    assert np.abs(values[:steps] - values[steps : 2 * steps]).max() > 0.01


def test_same_seeds_same_demonstration(tmp_path):
    def demonstration():
        robot = PneutacSim(PneutacSimConfig(id="sim", calibration_dir=tmp_path, seed=4))
        teleop = PneutacScripted(PneutacScriptedConfig(id="s", calibration_dir=tmp_path, seed=9))
        robot.connect()
        teleop.connect()
        actions = run(robot, teleop, 40)
        robot.disconnect()
        return actions

    assert demonstration() == demonstration()


def test_needs_a_simulated_robot_in_the_process(pair):
    robot, teleoperator = pair
    teleop = teleoperator()
    robot.disconnect()
    with pytest.raises(InputError, match="use --robot.type=pneutac_sim"):
        teleop.get_action()
    teleop.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        teleop.get_action()


def test_a_robot_that_is_not_simulated_is_refused_before_it_is_connected(tmp_path, monkeypatch):
    monkeypatch.setattr(pneutac_sim, "_made", WeakSet())
    with pytest.raises(InputError, match="there is no simulated robot here; use --robot.type=pneutac_sim"):
        PneutacScripted(PneutacScriptedConfig(id="s", calibration_dir=tmp_path)).connect()


def test_bad_options_are_named():
    with pytest.raises(DecodingError, match="episode_steps is 0"):
        PneutacScriptedConfig(episode_steps=0)


def test_it_gives_no_bends(tmp_path):
    robot = PneutacSim(PneutacSimConfig(id="sim", calibration_dir=tmp_path, fidelity="probe", bend=True))
    teleop = PneutacScripted(PneutacScriptedConfig(id="script", calibration_dir=tmp_path))
    teleop.connect()
    robot.connect()
    with pytest.raises(InputError, match="leave --robot.bend out"):
        teleop.get_action()
    robot.disconnect()
