"""Robots that are given a bend: the finger goes there, and every limit holds as for pressures."""

import logging
import time

import numpy as np
import pytest
from awake import awake_s
from draccus.utils import DecodingError

from lerobot_robot_pneutac.cameras.simulated import DigitGeneratedConfig
from lerobot_robot_pneutac.hardware.arms import SimulatedArmConfig
from lerobot_robot_pneutac.robots.base_robot import BEND_NAMES
from lerobot_robot_pneutac.robots.config_pneutac import PneutacConfig, PressureConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac import Pneutac
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value


def bend_of(world) -> float:
    """Of the arc from the finger's base to its tip."""
    base = world.data.body("finger")
    place = base.xmat.reshape(3, 3).T @ (world.data.site("tip").xpos - base.xpos)
    return 2 * np.arctan2(place[2], place[0])


def act(bend: float) -> dict:
    return dict(zip(BEND_NAMES, (0.0, 0.0, 0.0, bend), strict=True))


@pytest.fixture
def twin(tmp_path):
    twin = Twin.builtin()
    twin.effects["creep"] = {f"weight_{t}": Value(0.05) for t in ("0_4s", "1_3s", "4s", "13s", "40s", "130s")}
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.15), "vent_time_s": Value(0.3)}
    twin.save(tmp_path / "twin")
    return tmp_path / "twin"


@pytest.fixture
def robot(twin):
    robot = PneutacSim(PneutacSimConfig(id="bend", twin=twin, fidelity="probe", bend=True))
    robot.connect()
    yield robot
    robot.disconnect()


@pytest.mark.nightly
def test_the_finger_bends_as_commanded_in_spite_of_lag_and_creep(robot):
    assert list(robot.action_features) == list(BEND_NAMES)
    low, high = robot._bend._control.reach_rad
    for _ in range(2):
        for share in (0.6, 0.3):
            target, seen = low + share * (high - low), []
            for _ in range(60):
                assert robot.send_action(act(target)) == act(target)
                seen.append(bend_of(robot.world))
            assert np.abs(np.array(seen[30:]) - target).max() < 0.02 * (high - low)
        robot.reset()


def test_a_bend_out_of_reach_goes_as_far_as_it_can_and_is_reported_once(robot, caplog):
    with caplog.at_level(logging.WARNING):
        for _ in range(40):
            robot.send_action(act(9.0))
    assert robot.world.command[3] == 15.0
    assert caplog.text.count("out of reach") == 1


def test_without_the_option_a_bend_is_refused_in_a_sentence(twin):
    robot = PneutacSim(PneutacSimConfig(id="bend", fidelity="probe"))
    robot.connect()
    with pytest.raises(InputError, match="'bend.pos'; give --robot.bend=true"):
        robot.send_action(act(0.6))
    robot.disconnect()


@pytest.mark.realtime
def test_the_real_robot_turns_a_bend_into_pressure_and_refuses_nan(twin, tmp_path):
    parts = {"arm": SimulatedArmConfig(), "pressure": PressureConfig(type="simulated")}
    parts |= {"digit": DigitGeneratedConfig(), "twin": twin, "calibration_dir": tmp_path}
    robot = Pneutac(PneutacConfig(id="bend", bend=True, **parts))
    robot.connect()
    try:
        target = np.mean(robot._bend._control.reach_rad)
        end_s = awake_s() + 10.0
        while robot.guard._target_kpa < 2.0:  # the limits let the pressure rise by so much a second
            assert robot.send_action(act(target)) == act(target)
            assert awake_s() < end_s
            time.sleep(0.01)
        refused = robot.guard.refused
        robot.send_action(act(float("nan")))
        assert robot.guard.refused == refused + 1
    finally:
        robot.disconnect()


def test_a_bend_needs_the_twin_that_brings_it():
    parts = {"arm": SimulatedArmConfig(), "pressure": PressureConfig(type="simulated")}
    with pytest.raises(DecodingError, match="--robot.bend=true needs --robot.twin"):
        PneutacConfig(id="bend", bend=True, digit=DigitGeneratedConfig(), **parts)
    with pytest.raises(DecodingError, match="on the stand-in needs --robot.twin"):
        PneutacSimConfig(id="bend", bend=True, standin=True)
