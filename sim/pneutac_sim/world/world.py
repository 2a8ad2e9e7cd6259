"""The world of a twin: arm, pneumatic finger with its gel, and a task, stepped at the control rate.

One description serves environment, robot twin and planner. A control step integrates the Cartesian velocity,
solves the inverse kinematics once, and interpolates joint targets and pressure over the physics substeps.
"""

import logging
from collections import deque
from typing import override

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.features import CHAMBERS, FIDELITIES, RENDERS
from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import PAPER_FINGER, Twin, checked_range
from pneutac_sim.world import scene
from pneutac_sim.world.base import BaseWorld, Observation, Variation, imprint_m
from pneutac_sim.world.checks import Conditions, check_bends, conditions_for, draw
from pneutac_sim.world.scene import Finger
from pneutac_sim.world.soft_finger import Pad, Springs, mjcf
from pneutac_sim.world.spine import Follower, Placing, Spine
from pneutac_sim.world.station import Station
from pneutac_sim.world.tasks.base import HOME_JITTER_M, contact_force
from pneutac_sim.world.touch import Touch
from pneutac_sim.world.view import View

logger = logging.getLogger(__name__)


class World(BaseWorld):
    """Arm, finger and task of a twin, deterministic under `reset(seed)`; `BaseWorld` has the rest of it.

    Attributes:
        sensor: the gel's tactile sensor.
        conditions: what the twin's effects are given in this episode, such as `temperature_c`.
        chambers: C, of the finger.
        pressure_range_kpa: lowest and highest pressure that can be commanded to each, kPa.
        spine_target_rad: spine joint angles q_cmd (N,), with several chambers (N, 2), that the pressure
            commands, after the twin's effects.
        finger: the soft body round the spine, `SurrogateFinger` or `MpmFinger`; None where the spine's joints
            have the whole stiffness by themselves.
        out_of_range: number of steps since the reset in which a state of the finger or a contact lay outside
            what the networks were trained with.
        touch: last touch: `depth_mm`, `image`, `pixels`, `area`.
        variation: what is laid out on purpose, from the next reset on.
    """

    variation = Variation()

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
        sideways: bool = False,
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
            sideways: whether a load bends a finger of one chamber across its plane too: its joints are balls,
                as stiff across as in the plane, which is an assumption, as a bench measures the plane alone.

        Raises InputError: unknown task, touch mode, fidelity or render; an arm that does not reach; a twin
        that is of a gel, or has no networks or outdated ones, or a body stiffer than all of it, or several
        chambers with another fidelity than `probe` or with `sideways`; an effect without its conditions.
        """
        self.twin = twin or Twin.builtin()
        check_choice("fidelity", fidelity, FIDELITIES)
        check_bends(self.twin, fidelity)
        self.chambers, self._sideways = CHAMBERS[self.twin.device], sideways
        if sideways and self.chambers > 1:
            raise InputError(
                f"The twin's {self.twin.device} has {self.chambers} chambers; a finger that a load bends"
                " sideways is made of one chamber alone."
            )
        check_choice("render", render, RENDERS)
        wider = self.twin.pressure_range_kpa if pressure_range_kpa is None else pressure_range_kpa
        self.pressure_range_kpa = checked_range(wider, "pressure_range_kpa")
        super().__init__(task, station, self.twin.length_mm)
        self._warned = False
        self._substeps = scene.substeps(self.station.control_hz)
        # Share of a control step at the end of each substep.
        self._ramp = np.linspace(0, 1, self._substeps + 1)[1:, None]
        self._conditions = conditions_for(self.twin, conditions)
        self._pipeline = PressurePipeline(self.twin, draw(self._conditions, np.random.default_rng(0)))
        self.finger, gel = _deforming(self.twin, fidelity, touch)
        self.sensor = TactileSensor(self.twin)
        self.touch = Touch(self.model, self.sensor, touch, gel)
        self.view = _view(render, self.model, self.twin, self.sensor if touch == "image" else None)
        self._bind_model()
        whole = self.twin.parameter("joint_stiffness_nm_per_rad")
        whole = whole if self.finger is None else self.finger.controller_nm_per_rad
        self._controller = whole * np.eye(self._bends.joints)
        self.reset(0)

    def _bind_model(self) -> None:
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
        roots = (self.model.body(b) for b in np.flatnonzero(self.model.body_parentid == 0)[1:])
        self._roots = [b.id for b in roots if b.name not in ("panda", "arm", "gantry")]
        self._places = self.model.body_pos[self._roots].copy()
        self._grip = float(self.model.geom("pad").friction[0])

    def reset(self, seed: int | None = None) -> Observation:
        """Starts an episode, before which the finger has rested.

        Args:
            seed: decides everything and begins a session, with a new finger. None draws the next start of the
                same stream, in the same session: session time and what the finger's material remembers for
                good go on, as from trial to trial on the bench.
        """
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self._rest_rad = None
        self._start()
        self.conditions = draw(self._conditions, self._rng) | self.variation.conditions
        self._pipeline.set_conditions(self.conditions)
        self._pipeline.reset(0.0, same_session=seed is None)
        self.spine_target_rad = self._pipeline.rest()
        if self.finger is not None:
            self.finger.reset()
        self._drive = self._bend(self.spine_target_rad)
        self._rate = np.zeros_like(self._drive)
        self._bends.write(self.data, self._drive)
        if self._pipeline.moves:
            poses = self._placing.find(self._pipeline, self._in_plane(self._drive), self.dt_s)
            self._placing.set(self.model, poses)
        mujoco.mj_kinematics(self.model, self.data)
        self._settle(self.spine_target_rad)
        self._measure(self.dt_s)
        self.touch.sense(self.data)
        self._shown = deque([self._felt()] * self.variation.late_touch)
        return self._observe()

    @override
    def _lay_out(self) -> None:
        self._stage(self._rng, self.variation)

    def _stage(self, rng: np.random.Generator, variation: Variation) -> None:
        """Objects by the task's own random start, then moved, and the gel's grip."""
        model, data = self.model, self.data
        model.body_pos[self._roots] = self._places
        self.task.reset(model, data, rng)
        model.body_pos[self._roots] += variation.shift_m
        for b in self._roots:
            joint = model.body_jntadr[b]
            if joint >= 0 and model.jnt_type[joint] == 0:  # a free object stands where its joint says
                at = model.jnt_qposadr[joint]
                data.qpos[at : at + 3] += variation.shift_m
        model.geom("pad").friction[0] = self._grip * variation.friction

    @property
    @override
    def home_m(self) -> np.ndarray:
        start_m = self.variation.start_m
        return super().home_m if start_m is None else np.array(start_m)

    @property
    @override
    def _start_half_m(self) -> np.ndarray:
        return super()._start_half_m if self.variation.start_m is None else np.full(3, HOME_JITTER_M)

    @property
    @override
    def _starts_m(self) -> tuple[float, ...]:
        return super()._starts_m if self.variation.start_m is None else (0.0,)

    @property
    def blocked(self) -> bool:
        """Whether the objects were laid where the hand starts: it touches them, or the task is over."""
        touches = contact_force(self.model, self.data, "") > 0
        return touches or self.success or self.failure is not None

    def _felt(self) -> tuple:
        return self.touch.image, self.touch.pixels, self.touch.area

    @property
    @override
    def _late_commands(self) -> int:
        if self.variation.at_once:
            return 0
        # The twin has a latency of its own where demonstrations show one.
        known = self.twin.parameters.get("command_latency_s")
        own = self.station.steps(known.value) if known else 0
        return super()._late_commands + own + self.variation.late_commands

    def step(self, action: np.ndarray) -> Observation:
        """Advances one control step, `dt_s`.

        Args:
            action: (3 + C,) as `features.action_names`: flange velocity m/s in the world frame, pressure of
                each chamber kPa. What exceeds the limits is clipped and counted in `clipped`.

        Raises:
            InputError: the action has another shape or is not finite.
            DivergedError: the physics has diverged.
        """
        joints, pressures_kpa = self._send(action)
        self._advance(joints, self._pipeline.step(pressures_kpa, self.dt_s))
        scene.check_physics(self.data)
        self.task.update(self.model, self.data, self.dt_s)
        self._measure(self.dt_s)
        self.touch.sense(self.data)
        self.out_of_range += not (self.touch.in_range and (self.finger is None or self.finger.in_range))
        self._shown.append(self._felt())
        self.touch.image, self.touch.pixels, self.touch.area = self._shown.popleft()
        return self._observe()

    @override
    def _clip(self, action: np.ndarray) -> np.ndarray:
        before, clipped = self.clipped, super()._clip(action)
        if self.clipped > before and not self._warned:
            self._warned = True
            logger.warning(
                "The action %s is beyond the limits (0.1 m/s, %g to %g kPa) and was clipped; later ones"
                " are counted only. `pressure_range_kpa` drives a twin beyond what it was measured over.",
                *(np.round(action, 3).tolist(), *self.pressure_range_kpa),
            )
        return clipped

    @override
    def _advance(self, joints: np.ndarray, drive: np.ndarray) -> None:
        """Physics substeps of one control step, towards joint targets of the arm and the spine.

        M (q - q_d)'' + D (q - q_d)' = K_c (q_d - q) + f(q) - f(q_d), with the controller of stiffness K_c,
        the torque f of the soft body, and the path q_d on which `Follower` leads the free finger to where it
        is commanded. f is taken straight about the present q, so that MuJoCo's own springs of K = K_c - J
        have it at every substep.
        """
        after, before = self._bend(drive), self._drive
        K, rest = self._resist(before)
        D = self._springs.set(K)
        self._pad.feel(self.touch.objects(self.data))
        ctrl = np.tile(self.data.ctrl, (self._substeps, 1))
        ctrl[:, self._arm] = self._joints + self._ramp * (joints - self._joints)
        torques, self._rate = self._follower.torques(before, self._rate, after, K, D, self._substeps)
        ctrl[:, self._spine] = torques + rest
        goal = self._placing.poses
        if self._pipeline.moves:
            joints_then = self._in_plane(self.spine_rad + after - before)
            goal = self._placing.find(self._pipeline, joints_then, self.dt_s)
        if self._placing.stays(goal):
            self._placing.set(self.model, goal)
            self._physics.run(ctrl)
        else:
            for row, pose in zip(ctrl, self._placing.between(goal, self._ramp), strict=True):
                self.data.ctrl[:] = row
                self._placing.set(self.model, pose)
                mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        self._joints, self.spine_target_rad, self._drive = joints, drive, after

    def _resist(self, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness K (N, N) in N m/rad and the motors' torque beyond it, about the present joint angles.

        `drive` is where the free finger is at present, rad.
        """
        if self.finger is None:
            return self._controller, np.zeros(self._spine.stop - self._spine.start)
        q = self.spine_rad
        torque, J = self.finger.torque(drive, q)
        return self._controller - J, torque - J @ (q - drive)

    @override
    def _finger_mjcf(self) -> Finger:
        return mjcf(self.twin, self.station.mount_mm, axes=2 if self._sideways else None)

    def _bend(self, q_cmd: np.ndarray) -> np.ndarray:
        """Angles in rad at which the unloaded finger rests, by those that the pressure commands."""
        if self._rest_rad is None:  # at the reset, where the pressure is off
            self._rest_rad = q_cmd
        if self.variation is not World.variation:
            q_cmd = self._rest_rad + self.variation.bend_gain * (q_cmd - self._rest_rad)
            q_cmd = q_cmd + self.variation.more_rad / len(q_cmd)
        return np.stack([q_cmd, np.zeros_like(q_cmd)], axis=1) if self._sideways else q_cmd

    def _in_plane(self, q: np.ndarray) -> np.ndarray:
        """Those of joint angles that the pipeline has."""
        return q[:, 0] if self._sideways else q

    @property
    def tactile_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the tactile image, those of the twin's sensor."""
        h, w, c = self.sensor.rest_image.shape
        return h, w, c

    def _observe(self) -> Observation:
        d, joints = self.data, self._arm
        felt = [self.touch.area, np.log1p(self.touch.pixels), *self.pressures_kpa]
        state = np.concatenate([d.qpos[joints], d.qvel[joints], self.flange_m - self._base_m, felt])
        return Observation(state.astype(np.float32), self.touch.image)

    @property
    def renders_with_gl(self) -> bool:
        """Whether the last picture came from OpenGL; False before the first one and where it is drawn."""
        return self.view.uses_gl

    @property
    def pressure_kpa(self) -> float:
        """Pressure in the finger's first chamber, kPa; behind the command where the twin has a valve lag."""
        return float(self._pipeline.pressure_kpa[0])

    @property
    def pressures_kpa(self) -> np.ndarray:
        """Pressure in each chamber (C,), kPa."""
        return self._pipeline.pressure_kpa.copy()

    @property
    def spine_rad(self) -> np.ndarray:
        """Spine joint angles (N,), with several chambers (N, 2) towards +z and +y, rad."""
        return self._bends.read(self.data)

    @property
    def press_mm(self) -> float:
        """How far the gel's surface is pressed in, mm."""
        return -1e3 * float(self.data.joint("pad").qpos[0])

    @property
    def press_n(self) -> float:
        """Force on the gel, N: that of its own material, see `gel.force`."""
        return self._pad.spring.force(1e-3 * self.press_mm)

    @property
    def imprint_m(self) -> np.ndarray | None:
        """Where the gel is pressed, in its frame: across and along the finger (2,), metres; None where not.

        Along is positive towards the tip. The tactile image shows the same.
        """
        return imprint_m(self.model, self.data)

    @property
    def tip(self) -> np.ndarray:
        """Where the finger's tip is (5,): x, y, z in mm, bend towards +z and towards +y in rad.

        In the frame in which the base is thought to stand, x along the straight finger.
        """
        d = self.data
        flange = d.site_xmat[self._flange].reshape(3, 3)
        at = self._placing.in_base(d.site_xpos[self._tip], d.site_xpos[self._flange], flange)
        bend = np.append(self.spine_rad.sum(0), 0.0)[:2]
        return np.append(at, self._placing.turned + bend)

    @property
    def markers(self) -> np.ndarray:
        """What a bench's camera would read of the tip (5,): `tip` through the twin's observation."""
        return self._read if self._pipeline.measures else self.tip

    def _measure(self, dt_s: float) -> None:
        if self._pipeline.measures:
            self._read = self._pipeline.read(self.tip, dt_s)


_STATE = mujoco.mjtState
_FULL = _STATE.mjSTATE_FULLPHYSICS
# What is not named here a rollout sets to zero: forces that are applied from outside would be lost.
_INPUTS = _STATE.mjSTATE_CTRL | _STATE.mjSTATE_QFRC_APPLIED | _STATE.mjSTATE_XFRC_APPLIED


class Substeps:
    """Steps a MuJoCo model and its data, bit for bit as a loop over `mj_step` does."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self._model, self._data = model, data
        self._rollout = Rollout(nthread=0)
        self._state = np.empty((1, mujoco.mj_stateSize(model, _FULL)))

    def run(self, ctrl: np.ndarray) -> None:
        """A substep for each row of controls (S, nu), under the forces that are applied in the data."""
        model, data = self._model, self._data
        mujoco.mj_getState(model, data, self._state[0], _FULL)
        inputs = np.empty((1, len(ctrl), model.nu + model.nv + 6 * model.nbody))
        inputs[..., : model.nu] = ctrl
        inputs[..., model.nu : model.nu + model.nv] = data.qfrc_applied
        inputs[..., model.nu + model.nv :] = data.xfrc_applied.ravel()
        # It steps the data itself, so its own record of the states is left aside.
        how = {"control_spec": _INPUTS, "nstep": len(ctrl), "skip_checks": True}
        warm = data.qacc_warmstart[None].copy()
        self._rollout.rollout([model], [data], self._state, inputs, initial_warmstart=warm, **how)


def _deforming(twin: Twin, fidelity: str, touch: str):
    """What bends the finger, and what indents the gel; None for the formulas."""
    deforms = touch in ("image", "area")
    if fidelity == "surrogate":  # its modules take a second to start
        from pneutac_sim.surrogate.finger import Networks

        networks = Networks.of(twin)
        return networks.finger(twin), networks.gel if deforms else None
    if fidelity == "mpm":
        from pneutac_sim.world.mpm_gel import MpmFinger, MpmGel

        return MpmFinger(twin), MpmGel(twin) if deforms else None
    return None, None


def _view(render: str, model: mujoco.MjModel, twin: Twin, sensor: TactileSensor | None) -> View:
    """The view of a world, and its tactile images where a sensor is given.

    With `splats` the geoms of the finger's skin leave the seen groups of the model.
    """
    if render == "mesh":
        return View(model)
    from pneutac_sim.splat.gel import SplatSensor  # numba takes a second to start
    from pneutac_sim.world.splats import DEVICE, SplatView

    if sensor is not None:
        sensor.draw = SplatSensor(sensor.model, device=DEVICE).image
    return SplatView(model, twin)
