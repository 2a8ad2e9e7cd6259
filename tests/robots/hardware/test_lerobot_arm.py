"""An arm of LeRobot's behind our interface: a follower of five joints that lags as a servo does."""

import time
from dataclasses import dataclass

import numpy as np
import pytest
from awake import awake_s, hold_up_us, undisturbed
from draccus.utils import DecodingError
from lerobot.robots import Robot, RobotConfig

from lerobot_robot_pneutac.hardware import arms
from lerobot_robot_pneutac.hardware.arms import LeRobotArmConfig, SimulatedArmConfig
from lerobot_robot_pneutac.hardware.lerobot_arm import LeRobotArm
from lerobot_robot_pneutac.hardware.parts import COMMAND_S, HardwareFault
from pneutac_sim.errors import InputError
from pneutac_sim.world.arms import ARMS, Chain

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
SO101 = ARMS["so101"][0]


@RobotConfig.register_subclass("fake_follower")
@dataclass
class FakeFollowerConfig(RobotConfig):
    pass


class FakeFollower(Robot):
    """Five joints and a gripper in degrees; each reading is three quarters of the way to the target."""

    config_class, name = FakeFollowerConfig, "fake_follower"
    calibrated, stuck, breaks = True, False, False

    def __init__(self, config):
        super().__init__(config)
        self.at = np.degrees(np.append(SO101.home_rad, 0.0)) + 2.0  # the wrist is not straight
        self.target, self.connected = self.at.copy(), False

    observation_features = action_features = {f"{m}.pos": float for m in (*MOTORS, "gripper")}
    is_connected = property(lambda self: self.connected)
    is_calibrated = property(lambda self: self.calibrated)
    cameras: dict = {}

    def connect(self, calibrate=True):
        assert not calibrate
        self.connected = True

    def get_observation(self):
        if self.breaks:
            raise ConnectionError("no status packet")
        if not self.stuck:
            self.at += 0.75 * (self.target - self.at)
        return dict(zip(self.observation_features, self.at.tolist(), strict=True))

    def send_action(self, action):
        assert list(action) == [f"{m}.pos" for m in MOTORS]  # the gripper is left alone
        self.target[:5] = list(action.values())
        return action

    def disconnect(self):
        self.connected = False

    def calibrate(self):
        raise AssertionError

    configure = calibrate


@pytest.fixture
def follower(tmp_path):
    return FakeFollower(FakeFollowerConfig(id="x", calibration_dir=tmp_path))


@pytest.fixture
def arm(follower):
    chain = Chain(SO101.urdf, SO101.flange, SO101.home_rad, (0.0, 0.0, 0.0))
    arm = LeRobotArm(follower, tuple(f"{m}.pos" for m in MOTORS), chain, np.degrees(1))
    yield arm
    arm.disconnect()
    assert not follower.connected


def fault_of(arm, seconds=2.0):
    end_s = awake_s() + seconds
    while awake_s() < end_s:
        try:
            arm.state()
        except HardwareFault as fault:
            return str(fault)
        time.sleep(0.01)
    return None


@pytest.mark.realtime
def test_it_moves_with_a_velocity_rests_by_itself_and_keeps_its_orientation(arm, follower):
    def moves():
        arm.connect()
        start, rotation = arm.state(), arm._seen.pose(arm.state().joints_rad)[0]
        np.testing.assert_allclose(start.joints_rad, np.radians(follower.at[:5]), atol=1e-9)
        began_s = awake_s()
        arm.move(np.array([0.0, 0.04, -0.04]))
        time.sleep(COMMAND_S + 0.2)
        end = arm.state()
        time.sleep(0.1)
        later = arm.state()
        arm.disconnect()
        moved = end.flange_m - start.flange_m
        assert abs(moved[0]) < 1e-3 and 0.6 < moved[1] / (0.04 * COMMAND_S) < 1.2  # ticks may be late
        assert moved[1] == pytest.approx(-moved[2], abs=1e-3)
        turned = arm._chain.solver().pose(end.joints_rad)[0]
        np.testing.assert_allclose(turned, rotation, atol=0.01)
        np.testing.assert_allclose(later.flange_m, end.flange_m, atol=1e-4)
        assert awake_s() - began_s < 5

    undisturbed(moves)


@pytest.mark.realtime
def test_a_computer_that_stalls_is_not_taken_for_a_silent_arm(arm):
    arm.connect()
    for _ in range(3):
        hold_up_us(300_000)
        arm.state()


@pytest.mark.realtime
def test_a_stop_ends_a_motion(arm):
    arm.connect()
    arm.move(np.array([0.0, 0.05, 0.0]))
    arm.stop()
    time.sleep(0.1)
    before = arm.state().flange_m
    time.sleep(0.1)
    np.testing.assert_allclose(arm.state().flange_m, before, atol=1e-4)


@pytest.mark.realtime
def test_a_joint_that_stays_behind_and_a_lost_bus_are_faults(arm, follower):
    arm.connect()
    follower.stuck = True
    follower.at[1] += 25.0
    assert "'shoulder_lift.pos' is 0.44 rad from its target; free the arm" in fault_of(arm)
    with pytest.raises(HardwareFault, match="free the arm"):
        arm.move(np.zeros(3))
    arm.disconnect()
    follower.stuck, follower.target = False, follower.at.copy()
    arm.connect()
    follower.breaks = True
    assert "failed (no status packet)" in fault_of(arm)


def test_without_calibration_or_connection_it_says_what_to_do(arm, follower):
    with pytest.raises(HardwareFault, match="not connected"):
        arm.state()
    follower.calibrated = False
    with pytest.raises(HardwareFault, match="run lerobot-calibrate"):
        arm.connect()
    assert not follower.connected


def test_options_make_a_robot_of_lerobots_and_dry_runs_of_any_arm(tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot.robots.make_robot_from_config", FakeFollower)
    robot = {"type": "fake_follower", "id": "mine", "calibration_dir": str(tmp_path)}
    config = LeRobotArmConfig(robot=robot)
    assert config.joints == 5 and config.make()._motors == tuple(f"{m}.pos" for m in MOTORS)
    with pytest.raises(InputError, match=r"motors is \['gripper.pos'\].* each of the 5 joints"):
        LeRobotArmConfig(robot=robot, motors=["gripper.pos"]).make()
    with pytest.raises(InputError, match="robot.arm.robot: .*prot"):
        LeRobotArmConfig(robot=robot | {"prot": 1}).make()
    for options, says in (
        ({}, "robot.arm.robot is missing"),
        ({"robot": robot | {"use_degrees": False}}, "use_degrees=false"),
        ({"robot": robot, "model": "none.yaml"}, "There is no file 'none.yaml'"),
        ({"robot": robot, "model": "panda"}, "give --robot.arm.type=panda"),
    ):
        with pytest.raises(DecodingError, match=says):
            LeRobotArmConfig(**options)
    dry = SimulatedArmConfig(model="so101")
    arm = dry.make()
    arm.connect()
    assert dry.joints == 5 and arm.state().joints_rad.shape == (5,)
    assert arms.PandaConfig(ip="x").joints == 7
