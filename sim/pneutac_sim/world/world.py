"""The world: arm, pneumatic finger with its gel, and a task, stepped at the control rate.

One description serves environment, robot twin and planner. A control step integrates the Cartesian velocity,
solves the inverse kinematics once, and interpolates joint targets and pressure over the physics substeps.
"""

import logging
from collections import deque

import mujoco
import numpy as np

from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.features import CHAMBERS, FIDELITIES, PRESSURES, RENDERS, action_limits
from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import PAPER_FINGER, Twin, checked_range
from pneutac_sim.world import scene
from pneutac_sim.world.action import checked_action
from pneutac_sim.world.checks import check_bends
from pneutac_sim.world.conditions import Conditions, conditions_for, draw
from pneutac_sim.world.deforming import deforming
from pneutac_sim.world.drawn import drawn
from pneutac_sim.world.following import Follower
from pneutac_sim.world.observation import Observation
from pneutac_sim.world.pad import Pad
from pneutac_sim.world.placing import Placing
from pneutac_sim.world.scene import Finger
from pneutac_sim.world.senses import Senses
from pneutac_sim.world.soft_finger import Springs, mjcf
from pneutac_sim.world.spine import Spine
from pneutac_sim.world.station import MISSING_M, Station
from pneutac_sim.world.substeps import Substeps
from pneutac_sim.world.tasks import make_task
from pneutac_sim.world.tasks.base import HOME_JITTER_M
from pneutac_sim.world.touch import Touch

logger = logging.getLogger(__name__)


class World(Senses):
    """Arm, finger and task, deterministic under `reset(seed)`.

    Attributes:
        task: the task; `task.description` is the instruction.
        sensor: the gel's tactile sensor.
        conditions: what the twin's effects are given in this episode, such as `temperature_c`.
        time_s: simulated time since the reset.
        dt_s: duration of a control step.
        chambers: C, of the finger.
        pressure_range_kpa: lowest and highest pressure that can be commanded to each, kPa.
        action_limits: lowest and highest action (3 + C,).
        station: where the finger works.
        arm: what carries it.
        workspace_m: corners (3,) of the box to which the flange is held, metres.
        clipped: number of commands that were clipped to limits since the reset; the first is logged too.
        command: last action after clipping (3 + C,), which acts as late as the station says.
        target_m: where the flange is sent (3,), metres in the station's frame.
        spine_target_rad: spine joint angles q_cmd (N,), with several chambers (N, 2), that the pressure
            commands, after the twin's effects.
        finger: the soft body round the spine, `SurrogateFinger` or `MpmFinger`; None where the spine's joints
            have the whole stiffness by themselves.
        out_of_range: number of steps since the reset in which a state of the finger or a contact lay outside
            what the networks were trained with.
        touch: last touch: `depth_mm`, `image`, `pixels`, `area`.
        view: draws the scene, for `render` and scene cameras.
        model, data: MuJoCo's, for planners, experts and tests.
    """

    def __init__(
        self,
        task: str = "switch",
        twin: Twin | None = None,
        touch: str = "image",
        fidelity: str = "probe",
        conditions: Conditions | None = None,
        render: str = "mesh",
        pressure_range_kpa: tuple[float, float] | None = None,
        station: Station | None = None,
    ):
        """A world with a task.

        Args:
            task: a task's name, see `features.task_names`.
            twin: the finger with its gel, or an arm of several chambers with a gel at its tip; default the
                built-in finger.
            touch: `image`, `area` (contact area without an image, faster), `probe` (the
                probe grid alone) or `none`.
            fidelity: how finger and gel deform. `surrogate`: by networks in place of material points; `mpm`:
                by the material points themselves, for checks and short episodes; `probe`: by formulas, the
                joints with the twin's stiffness and the gel as a layer on springs.
            conditions: what effects of the twin ask for, such as `temperature_c` or `payload_g`: a number, or
                a range [low, high] from which every episode draws. The direction of gravity in the frame of
                the finger's base is the world's own where it is not given.
            render: what draws touch and finger: `mesh`, light on every pixel and MuJoCo's geoms, or `splats`,
                the Gaussians of the gel and of the twin's body over MuJoCo's scene.
            pressure_range_kpa: pressures that can be commanded in place of those that the twin was measured
                over; beyond these the twin is extrapolated.
            station: arm, workspace and mount; default the paper's.

        Raises:
            InputError: unknown task, touch mode, fidelity or render; an arm that does not reach; a twin
                that is of a gel, or has no networks or outdated ones, or a body stiffer than all of it, or
                several chambers with another fidelity than `probe`; an effect without its conditions.
        """
        self.task = make_task(task)
        self.twin = twin or Twin.builtin()
        check_choice("fidelity", fidelity, FIDELITIES)
        check_bends(self.twin, fidelity)
        self.chambers = CHAMBERS[self.twin.device]
        check_choice("render", render, RENDERS)
        wider = self.twin.pressure_range_kpa if pressure_range_kpa is None else pressure_range_kpa
        self.pressure_range_kpa = checked_range(wider, "pressure_range_kpa")
        limits = action_limits(self.pressure_range_kpa, self.chambers)
        self.action_limits = tuple(limit.astype(float) for limit in limits)
        self._told = False
        # Tasks are laid out for the paper's finger: with a longer one the flange keeps as much higher.
        self.station = station or Station()
        self.workspace_m = self.station.box_m(self.twin.length_mm)
        self._lift_m = self.workspace_m[0] - self.station.workspace_low_m
        self.arm = self.station.make_arm()
        self.dt_s, self._substeps = self.station.dt_s, scene.substeps(self.station.control_hz)
        # Share of a control step at the end of each substep.
        self._ramp = np.linspace(0, 1, self._substeps + 1)[1:, None]
        self._base_m = self.arm.base_m  # of the frame in which the arm is told where to go
        self._conditions = conditions_for(self.twin, conditions)
        self._pipeline = PressurePipeline(self.twin, draw(self._conditions, np.random.default_rng(0)))
        self.finger, gel = deforming(self.twin, fidelity, touch)
        self.model = mujoco.MjModel.from_xml_string(
            scene.build(
                self.task,
                self._made(),
                self.arm.body,
                self.arm.servos,
                self.station.control_hz,
            )
        )
        self.data = mujoco.MjData(self.model)
        self.sensor = TactileSensor(self.twin)
        self.touch = Touch(self.model, self.sensor, touch, gel)
        self._ik = self.arm.solver()
        self.view = drawn(render, self.model, self.twin, self.sensor if touch == "image" else None)
        self._rng = np.random.default_rng()
        self._flange = self.model.site("flange").id
        self._gel = self.model.site("gel").id

        # The arm's joints and servos come first in the model, then the spine's.
        self._arm = slice(0, self.arm.joints)
        self._hold()
        whole = (
            self.twin.parameter("joint_stiffness_nm_per_rad")
            if self.finger is None
            else (self.finger.controller_nm_per_rad)
        )
        self._controller = whole * np.eye(self._bends.joints)
        self.reset(0)

    def _hold(self) -> None:
        """Takes hold of the finger in the model, which has been built."""
        self._bends = Spine(self.model, self.twin)
        self._spine = self._bends.dofs
        self._physics = Substeps(self.model, self.data)
        self._pad = Pad(self.model, self.twin, self.sensor.triangles)
        whole = self.twin.parameter("joint_stiffness_nm_per_rad")
        known = self.twin.parameters.get("joint_damping_nms_per_rad")
        damping = known.value if known else PAPER_FINGER["joint_damping_nms_per_rad"]
        self._springs = Springs(self.model, self._bends.joints, damping, whole)
        self._follower = Follower(self.model, self._bends.joints)
        self._tip, self._placing = self.model.site("tip").id, Placing(self.model)

    # ---------------------------------------------------------------- episode

    def reset(self, seed: int | None = None) -> Observation:
        """Starts an episode, before which the finger has rested.

        Args:
            seed: decides everything and begins a session, with a new finger. None draws the next start of the
                same stream, in the same session: session time and what the finger's material remembers for
                good go on, as from trial to trial on the bench.
        """
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        mujoco.mj_resetData(self.model, self.data)
        self.task.reset(self.model, self.data, self._rng)
        self.target_m = self.home_m + self._rng.uniform(-1, 1, 3) * HOME_JITTER_M
        self.target_m[1] += self._rng.choice(self.task.starts_m)
        self._ik.reset()
        for _ in range(20):
            self._joints = self._ik.solve(self.target_m - self._base_m)
        if self._ik.missing_m > MISSING_M:
            raise InputError(
                f"The arm falls {self._ik.missing_m:.2g} m short of {np.round(self.target_m, 3).tolist()} m,"
                f" where the task '{self.task.name}' starts; give the station another base_m or home_rad."
            )
        self.conditions = self._draw_conditions()
        self._pipeline.set_conditions(self.conditions)
        self._pipeline.reset(0.0, same_session=seed is None)
        self.spine_target_rad = self._pipeline.rest()
        self.data.qpos[self._arm] = self._joints
        if self.finger is not None:
            self.finger.reset()
        self._drive = self._bend(self.spine_target_rad)
        self._rate = np.zeros_like(self._drive)
        self._bends.write(self.data, self._drive)
        if self._pipeline.moves:
            self._placing.set(
                self.model, self._placing.find(self._pipeline, self._in_plane(self._drive), self.dt_s)
            )
        self.clipped = self.out_of_range = 0
        self.command = np.zeros(len(self.action_limits[0]))
        self._sent = deque([self.command] * self._late_commands)
        mujoco.mj_kinematics(self.model, self.data)
        for _ in range(self.station.steps(scene.SETTLE_S)):
            self._advance(self._joints, self.spine_target_rad)
        self.data.time = 0.0
        self._measure(self.dt_s)
        self.touch.sense(self.data)
        return self._observe()

    @property
    def home_m(self) -> np.ndarray:
        """Where the flange starts (3,) before the random part of it, metres."""
        return np.array(self.station.home_m or self.task.home_m + self._lift_m)

    @property
    def _late_commands(self) -> int:
        """Control steps by which commands act late: the station's and, as demonstrations told, the twin's."""
        known = self.twin.parameters.get("command_latency_s")
        return self.station.late_commands + (self.station.steps(known.value) if known else 0)

    def _draw_conditions(self) -> dict[str, float]:
        return draw(self._conditions, self._rng)

    def step(self, action: np.ndarray) -> Observation:
        """Advances one control step, `dt_s`.

        Args:
            action: (3 + C,) as `features.action_names`: flange velocity m/s in the world frame, pressure of
                each chamber kPa. What exceeds the limits is clipped and counted in `clipped`.

        Raises:
            InputError: the action has another shape or is not finite.
            FloatingPointError: the physics has diverged.
        """
        self.command = self._clip(action)
        self._sent.append(self.command)
        sent = self._sent.popleft()
        wanted = self.target_m + sent[:3] * self.dt_s
        target = np.clip(wanted, *self.workspace_m)
        self.clipped += int(np.any(target != wanted))
        joints = self._ik.solve(target - self._base_m)
        if self._ik.missing_m > MISSING_M:  # it stays where it was, and goes on from there
            self.clipped, target, joints = self.clipped + 1, self.target_m, self._joints
            self._ik.reset(joints)
        self.target_m = target
        self._advance(joints, self._pipeline.step(sent[PRESSURES], self.dt_s))
        scene.check_physics(self.data)
        self.task.update(self.model, self.data, self.dt_s)
        self._measure(self.dt_s)
        self.touch.sense(self.data)
        self.out_of_range += not (self.touch.in_range and (self.finger is None or self.finger.in_range))
        return self._observe()

    def _clip(self, action) -> np.ndarray:
        action = checked_action(action, self.chambers)
        clipped = np.clip(action, *self.action_limits)
        # A float32 action at the limit is not beyond it.
        if np.any(np.abs(clipped - action) > 1e-6 * np.maximum(1.0, np.abs(action))):
            self.clipped += 1
            if not self._told:
                self._told = True
                low, high = self.pressure_range_kpa
                logger.warning(
                    "The action %s is beyond the limits (0.1 m/s, %g to %g kPa) and was clipped; later ones"
                    " are counted only. `pressure_range_kpa` drives a twin beyond what it was measured over.",
                    np.round(action, 3).tolist(),
                    low,
                    high,
                )
        return clipped

    def _advance(self, joints: np.ndarray, spine: np.ndarray) -> None:
        """Physics substeps of one control step, towards joint targets of the arm and the spine.

        M (q - q_d)'' + D (q - q_d)' = K_c (q_d - q) + f(q) - f(q_d), with the controller of stiffness K_c,
        the torque f of the soft body, and the path q_d on which `Follower` leads the free finger to where it
        is commanded. f is taken straight about the present q, so that MuJoCo's own springs of K = K_c - J
        have it at every substep.
        """
        drive, before = self._bend(spine), self._drive
        K, rest = self._resist(before)
        D = self._springs.set(K)
        self._pad.feel(self.touch.objects(self.data))
        ctrl = np.tile(self.data.ctrl, (self._substeps, 1))
        ctrl[:, self._arm] = self._joints + self._ramp * (joints - self._joints)
        torques, self._rate = self._follower.torques(before, self._rate, drive, K, D, self._substeps)
        ctrl[:, self._spine] = torques + rest
        goal = self._placing.poses
        if self._pipeline.moves:
            goal = self._placing.find(
                self._pipeline, self._in_plane(self.spine_rad + drive - before), self.dt_s
            )
        if self._placing.stays(goal):
            self._placing.set(self.model, goal)
            self._physics.run(ctrl)
        else:
            for row, pose in zip(ctrl, self._placing.between(goal, self._ramp), strict=True):
                self.data.ctrl[:] = row
                self._placing.set(self.model, pose)
                mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        self._joints, self.spine_target_rad, self._drive = joints, spine, drive

    def _resist(self, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness K (N, N) in N m/rad and the motors' torque beyond it, about the present joint angles.

        Args:
            drive: where the free finger is at present, rad.
        """
        if self.finger is None:
            return self._controller, np.zeros(self._spine.stop - self._spine.start)
        q = self.spine_rad
        torque, J = self.finger.torque(drive, q)
        return self._controller - J, torque - J @ (q - drive)

    def _made(self) -> Finger:
        """The finger's MJCF."""
        return mjcf(self.twin, self.station.mount_mm)

    def _bend(self, q_cmd: np.ndarray) -> np.ndarray:
        """Angles in rad at which the unloaded finger rests; here those that the pressure commands."""
        return q_cmd

    def _in_plane(self, q: np.ndarray) -> np.ndarray:
        """Those of joint angles that the pipeline has; here all."""
        return q

    # ---------------------------------------------------------------- senses

    @property
    def tactile_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the tactile image, those of the twin's sensor."""
        h, w, c = self.sensor.rest_image.shape
        return h, w, c

    def _observe(self) -> Observation:
        d = self.data
        s = self.touch.pixels
        state = np.concatenate(
            [
                d.qpos[self._arm],
                d.qvel[self._arm],
                d.site_xpos[self._flange] - self._base_m,
                [self.touch.area, np.log1p(s), *self.pressures_kpa],
            ]
        )
        return Observation(state.astype(np.float32), self.touch.image)

    @property
    def time_s(self) -> float:
        """Simulated seconds since the reset."""
        return self.data.time

    @property
    def success(self) -> bool:
        """Whether the task is done."""
        return self.task.success()

    @property
    def failure(self) -> str | None:
        """What has spoilt the trial, or None."""
        return self.task.failure()

    def render(self, width: int = 480, height: int = 360) -> np.ndarray:
        """Picture of the scene with the tactile image in a corner, uint8 (height, width, 3)."""
        return self.view.picture(self.data, self.touch.image, width, height)

    @property
    def renders_with_gl(self) -> bool:
        """Whether the last picture came from OpenGL; False before the first one and where it is drawn."""
        return self.view.uses_gl

    def close(self) -> None:
        """Frees the renderer."""
        self.view.close()
