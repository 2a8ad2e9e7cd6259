"""`PandaArm`: against a stand-in of franky everywhere, against franky itself where it is installed."""

import sys
import time
import types

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lerobot_robot_pneutac.hardware.panda import RECOVERIES, PandaArm
from lerobot_robot_pneutac.hardware.parts import COMMAND_S, HardwareFault
from lerobot_robot_pneutac.hardware.safety import Guard, Limits
from lerobot_robot_pneutac.hardware.simulated import SimulatedArm, SimulatedPressure


class StandIn(types.ModuleType):
    """As much of franky as `PandaArm` uses, its robot a `SimulatedArm`."""

    class ControlException(Exception):  # noqa: N818
        pass

    class NetworkException(Exception):  # noqa: N818
        pass

    def __init__(self):
        super().__init__("franky")
        self.RealtimeConfig = types.SimpleNamespace(Enforce="enforce", Ignore="ignore")
        self.ControllerMode = types.SimpleNamespace(JointImpedance="joints")
        self.robot = None
        self.unreachable = False

    def RelativeDynamicsFactor(self, velocity, acceleration, jerk):
        return velocity, acceleration, jerk

    def Twist(self, linear_velocity=(0, 0, 0), angular_velocity=(0, 0, 0)):
        return np.array(linear_velocity, float), np.array(angular_velocity, float)

    def RobotVelocity(self, end_effector_twist):
        return end_effector_twist

    def Duration(self, milliseconds):
        return milliseconds

    def CartesianVelocityWaypoint(self, target, hold_target_duration=0):
        return target, hold_target_duration

    def CartesianVelocityWaypointMotion(self, waypoints):
        return waypoints

    def CartesianVelocityStopMotion(self):
        return "stop"

    def Robot(self, ip, **options):
        if self.unreachable:
            raise self.NetworkException("libfranka: Connection refused")
        self.robot = StandInRobot(self, ip, options)
        return self.robot


class Affine:
    def __init__(self, matrix):
        self.matrix = matrix
        self.translation = matrix[:3, 3]

    @property
    def inverse(self):
        return Affine(np.linalg.inv(self.matrix))

    def __mul__(self, other):
        return Affine(self.matrix @ other.matrix)


class StandInRobot:
    def __init__(self, franky, ip, options):
        self.franky, self.ip, self.options = franky, ip, options
        self.arm = SimulatedArm()
        self.arm.connect()
        self.motions, self.has_errors, self.recoverable = [], False, True
        self.current = types.SimpleNamespace(cartesian_reflex=False, joint_reflex=False)
        self.raises, self.recoveries, self.clock = None, 0, 0.0
        self.dead = self.frozen = False
        self.is_in_control = False
        self.translation_velocity_limit = types.SimpleNamespace(set=lambda v: setattr(self, "speed", v))
        self.hand = np.eye(4)
        self.hand[:3, 3] = [0, 0, 0.1]

    def set_collision_behavior(self, torque, force):
        self.collision = torque, force

    @property
    def state(self):
        if self.dead:
            raise self.franky.NetworkException("libfranka: UDP receive: Timeout")
        self.clock += 0.0 if self.frozen else 0.001
        s, pose = self.arm.state(), np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.arm._ik.pose(s.joints_rad)
        return types.SimpleNamespace(
            q=s.joints_rad,
            dq=s.joints_rad_s,
            O_T_EE=Affine(pose @ self.hand),
            F_T_EE=Affine(self.hand),
            O_F_ext_hat_K=np.array([3.0, 0, -4.0, 9, 9, 9]),
            current_errors=self.current,
            time=types.SimpleNamespace(to_sec=lambda t=self.clock: t),
        )

    def poll_motion(self):
        if self.raises:
            raised, self.raises = self.raises, None
            raise raised
        return True

    def recover_from_errors(self):
        self.recoveries += 1
        if self.recoverable:
            self.has_errors = self.current.cartesian_reflex = False
        return self.recoverable

    def move(self, motion, asynchronous=False):
        assert asynchronous
        self.motions.append(motion)
        self.is_in_control = True
        self.arm.move(np.zeros(3) if motion == "stop" else motion[0][0][0])

    def join_motion(self, timeout=None):
        return True

    def reflex(self):
        self.has_errors = self.current.cartesian_reflex = True


@pytest.fixture
def franky(monkeypatch):
    module = StandIn()
    monkeypatch.setitem(sys.modules, "franky", module)
    return module


@pytest.fixture
def arm(franky):
    arm = PandaArm("10.0.0.2", dynamics=0.1, speed_m_s=0.2, collision_n=25.0, collision_nm=15.0)
    arm.connect()
    return arm


def test_limits_and_thresholds_are_set_before_anything_moves(franky, arm):
    robot = franky.robot
    assert robot.ip == "10.0.0.2" and robot.motions == []
    assert robot.options["relative_dynamics_factor"] == (1.0, 0.1, 0.1)
    assert robot.options["realtime_config"] == "enforce"
    assert robot.speed == 0.2 and robot.collision == (15.0, 25.0)


def test_the_state_is_of_the_flange_and_the_force_without_torques(franky, arm):
    state = arm.state()
    np.testing.assert_allclose(state.flange_m, franky.robot.arm.state().flange_m, atol=1e-12)
    assert state.force_n == pytest.approx(5.0)
    assert state.joints_rad.shape == state.joints_rad_s.shape == (7,)


def test_every_motion_ends_at_rest_by_itself_and_holds_the_orientation(franky, arm):
    arm.move(np.array([0.05, 0.0, -0.02]))
    (go, hold_ms), (rest, _) = franky.robot.motions[-1]
    np.testing.assert_allclose(go[0], [0.05, 0.0, -0.02])
    np.testing.assert_allclose(go[1], 0, atol=1e-9)
    assert hold_ms == 1000 * COMMAND_S
    assert not np.any(rest)
    franky.robot.hand[:3, :3] = [[1, 0, 0], [0, np.cos(0.05), -np.sin(0.05)], [0, np.sin(0.05), np.cos(0.05)]]
    arm.move(np.zeros(3))
    turn = franky.robot.motions[-1][0][0][1]
    tilted = franky.robot.state.O_T_EE.matrix[:3, :3]
    held = arm._held.as_matrix()
    small = Rotation.from_rotvec(0.1 * turn).as_matrix()  # a tenth of a second of it
    assert np.linalg.norm(small @ tilted - held) < np.linalg.norm(tilted - held)


@pytest.mark.realtime
def test_the_flange_follows(franky, arm):
    start = arm.state().flange_m
    for _ in range(6):
        arm.move(np.array([0.0, 0.05, 0.0]))
        time.sleep(0.03)
    arm.stop()
    moved = arm.state().flange_m - start
    assert 0.005 < moved[1] < 0.03 and abs(moved[[0, 2]]).max() < 2e-3


def test_a_reflex_is_cleared_said_and_its_command_dropped(franky, arm, caplog):
    franky.robot.reflex()
    arm.move(np.array([0.05, 0, 0]))
    assert franky.robot.recoveries == 1 and franky.robot.motions == []
    assert "cartesian_reflex" in caplog.text
    arm.move(np.array([0.05, 0, 0]))
    assert len(franky.robot.motions) == 1


def test_a_reflex_that_stops_a_motion_is_cleared_too_but_not_a_replaced_motion(franky, arm):
    franky.robot.raises = franky.ControlException("libfranka: Move command aborted: cartesian_reflex")
    arm.move(np.zeros(3))
    assert franky.robot.recoveries == 1
    franky.robot.raises = franky.ControlException("libfranka: Move command preempted!")
    arm.move(np.zeros(3))
    assert franky.robot.recoveries == 1


def test_reflexes_again_and_again_or_one_that_stays_are_faults(franky, arm):
    for _ in range(RECOVERIES):
        franky.robot.reflex()
        arm.move(np.zeros(3))
    franky.robot.reflex()
    with pytest.raises(HardwareFault, match="stopped itself 4 times"):
        arm.move(np.zeros(3))
    arm._reflexes.clear()
    franky.robot.recoverable = False
    with pytest.raises(HardwareFault, match="stays stopped"):
        arm.move(np.zeros(3))


def test_a_lost_connection_is_a_fault_and_stopping_never_raises(franky, arm):
    franky.robot.frozen = True
    arm.state()
    time.sleep(COMMAND_S + 0.05)
    with pytest.raises(HardwareFault, match="sends no new state"):
        arm.state()
    franky.robot.dead = True
    for call in (arm.state, lambda: arm.move(np.zeros(3))):
        with pytest.raises(HardwareFault, match="10.0.0.2 does not answer"):
            call()
    franky.robot.is_in_control = True
    franky.robot.move = lambda *_, **__: 1 / 0
    arm.stop()
    arm.disconnect()
    with pytest.raises(HardwareFault, match="not connected"):
        arm.state()


def test_what_hinders_connecting_is_said(franky, monkeypatch):
    franky.unreachable = True
    with pytest.raises(HardwareFault, match="10.0.0.3 does not answer .*Connection refused"):
        PandaArm("10.0.0.3").connect()
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(HardwareFault, match="pip install"):
        PandaArm("10.0.0.3").connect()
    arm = PandaArm("10.0.0.3")
    arm.stop()
    arm.disconnect()


# ---------------------------------------------------------------- the library itself


@pytest.fixture(scope="module")
def real():
    return pytest.importorskip("franky", reason="franky is not installed: pip install franky-control")


def test_an_address_without_a_robot_is_one_sentence(real):
    with pytest.raises(HardwareFault, match="127.0.0.9 does not answer"):
        PandaArm("127.0.0.9", realtime=False).connect()


def test_franky_drives_a_simulated_robot_over_the_real_protocol(real):
    """franky-sim speaks the robot's own network protocol; a lost server is a lost arm."""
    sim = pytest.importorskip("franky_sim", reason="franky-sim is not installed: pip install franky-sim")
    from franky_sim.mujoco_simulator import MujocoSimulator

    with MujocoSimulator() as simulator:
        model = simulator.add_robot()
        with sim.SimulationServer(simulator) as server:
            server.run_async()
            arm = PandaArm(model.hostname, realtime=False)
            arm.connect()
            start = arm.state().flange_m
            for _ in range(15):
                arm.move(np.array([0.05, 0.0, 0.0]))
                time.sleep(1 / 15)
            moved = arm.state().flange_m - start
            assert 0.01 < moved[0] < 0.06 and np.abs(moved[1:]).max() < 1e-3
            time.sleep(1.0)  # no command: at rest by itself
            rests = arm.state().flange_m
            time.sleep(0.2)
            np.testing.assert_allclose(arm.state().flange_m, rests, atol=1e-4)
            arm.move(np.array([0.0, 0.05, 0.0]))
            time.sleep(0.1)
            arm.stop()
            time.sleep(0.4)
            rests = arm.state().flange_m
            time.sleep(0.1)
            np.testing.assert_allclose(arm.state().flange_m, rests, atol=1e-4)
            chamber = SimulatedPressure()
            chamber.connect()
            guard = Guard(arm, chamber, Limits())
            guard.start()
            for _ in range(15):
                guard.act(np.array([0.0, 0.03, 0.0, 5.0]))
                time.sleep(1 / 15)
            assert chamber.pressure() > 4
            ended = time.monotonic()
    while guard.fault is None and time.monotonic() < ended + 3:
        time.sleep(0.01)
    assert "does not answer" in str(guard.fault) or "no new state" in str(guard.fault)
    time.sleep(0.5)
    assert chamber.pressure() < 0.1
    guard.close()
    arm.disconnect()
