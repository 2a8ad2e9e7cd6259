import logging
from weakref import WeakSet

import lerobot.datasets  # noqa: F401  as lerobot-record has it: without datasets nobody announces
import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot.utils.utils import log_say

from lerobot_robot_pneutac.robots import pneutac_sim
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_sim.errors import InputError
from pneutac_sim.features import (
    ACTION_HIGH,
    ACTION_LOW,
    ACTION_NAMES,
    CONTROL_HZ,
    DEMONSTRATION_S,
    task_names,
)


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


@pytest.mark.parametrize(("task", "control_hz"), [*((task, 15) for task in task_names()), ("card", 30)])
def test_every_episode_that_is_announced_is_one_demonstration(task, control_hz, tmp_path, caplog):
    """LeRobot counts seconds and the world steps: how many an episode has depends on the computer."""
    caplog.set_level(logging.INFO)
    (tmp_path / "station.yaml").write_text(f"format: pneutac-station/1\ncontrol_hz: {control_hz}\n")
    own = {"calibration_dir": tmp_path, "id": "one"}
    where = {"task": task, "fidelity": "probe", "station": tmp_path / "station.yaml"}
    robot, teleop = (
        PneutacSim(PneutacSimConfig(**where, **own)),
        PneutacScripted(PneutacScriptedConfig(episode_steps=12, **own)),
    )
    teleop.connect()
    robot.connect()
    for episode, (ticks, pause) in enumerate([(11, 0), (14, 5), (13, 8), (25, 0)]):
        log_say(f"Recording episode {episode}", play_sounds=False)
        assert robot.world.time_s == 0 and robot.outcome is None
        for action in run(robot, teleop, ticks):
            assert "reset" not in action and any(action.values())
        assert robot.world.time_s == pytest.approx(ticks / control_hz)
        if episode < 3:
            log_say("Reset the environment", play_sounds=False)
        assert len(robot.successes) == episode + (episode < 3)
        assert not any(any(action.values()) for action in run(robot, teleop, pause))
        assert robot.outcome == "the task was not done", "a pause after the episode changes nothing"
    log_say("Stop recording", play_sounds=False)
    assert len(robot.successes) == 4
    robot.disconnect()


def test_where_no_episodes_are_announced_the_scene_is_reset_after_the_last_tick(pair):
    robot, teleoperator = pair
    actions = run(robot, teleoperator(episode_steps=4), 8)
    assert [i for i, a in enumerate(actions) if a.get("reset")] == [3, 7]
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


def test_it_drags_where_the_expert_can(pair):
    robot, teleoperator = pair
    with pytest.raises(InputError, match="The expert of the task 'switch' does not drag; leave --teleop"):
        teleoperator(drag_mm=12).get_action()
    with pytest.raises(DecodingError, match="drag_mm is 30; it must be 0 or more and at most 20"):
        PneutacScriptedConfig(drag_mm=30)


def test_it_gives_no_bends(tmp_path):
    robot = PneutacSim(PneutacSimConfig(id="sim", calibration_dir=tmp_path, fidelity="probe", bend=True))
    teleop = PneutacScripted(PneutacScriptedConfig(id="script", calibration_dir=tmp_path))
    teleop.connect()
    robot.connect()
    with pytest.raises(InputError, match="leave --robot.bend out"):
        teleop.get_action()
    robot.disconnect()
