"""What every simulated world has: arm, task, start, command queue, clipping and inverse kinematics.

`world.World` of a twin and the stand-in are built on it. It knows neither finger nor gel of theirs.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.features import PRESSURES, action_limits
from pneutac_sim.world import scene
from pneutac_sim.world.station import MISSING_M, Station
from pneutac_sim.world.tasks import make_task
from pneutac_sim.world.tasks.base import HOME_JITTER_M, WIDER_M
from pneutac_sim.world.view import View

START_SOLVES = 20  # calls of the inverse kinematics, after which it has converged to the start
MOST_WIDE = 2.0  # width of starts beyond which the arm may meet the objects
CONTACT_N = 0.02  # a smaller force on the gel is no contact


@dataclass
class Observation:
    """What a robot senses once a control step."""

    state: np.ndarray  # (2 N + 5 + C,) float32 as `features.state_names` of an arm of N joints and C chambers
    tactile: np.ndarray | None  # uint8 (H, W, 3) of the sensor's size, or None where the world has no image


@dataclass(frozen=True)
class Variation:
    """What is different from the scene that the task itself draws."""

    # flange position (3,) at the start, metres; None for the task's own
    start_m: tuple[float, float, float] | None = None
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # displacement (3,) of the task's objects, metres
    bend_gain: float = 1.0  # factor on the bend that the pressure makes
    friction: float = 1.0  # factor on the friction of the gel
    late_commands: int = 0  # control steps by which commands act later than the station says
    late_touch: int = 0  # control steps by which touch is shown too late
    conditions: dict[str, float] = field(default_factory=dict)  # in place of those that the world draws
    at_once: bool = False  # whether commands act without any latency in place of that
    more_rad: float = 0.0  # bend in addition to that, shared by the joints


def converged(solver, flange_m: np.ndarray) -> np.ndarray:
    """Angles (..., N) rad of an arm whose flange stands there (..., 3), by a solver that begins anywhere."""
    for _ in range(START_SOLVES):
        joints = solver.solve(flange_m)
    return joints


def solved_joints(solver, flange_m: np.ndarray, velocity_m_s: np.ndarray, dt_s: float) -> np.ndarray:
    """Angles (..., N) rad and rates (..., N) rad/s, (2, ..., N), of an arm whose flange moves like that.

    `solver` is the inverse kinematics of one arm or of several, which begins near; positions and velocities
    (..., 3) are in the arm's frame.
    """
    half_m = velocity_m_s * dt_s / 2
    before, now, after = (solver.solve(x) for x in (flange_m - half_m, flange_m, flange_m + half_m))
    return np.stack([now, (after - before) / dt_s])


class BaseWorld(ABC):
    """Arm and task before a finger, deterministic under `reset(seed)`.

    A subclass sets `chambers`, and `pressure_range_kpa` in kPa, before it calls `__init__`.

    Attributes:
        task: the task; `task.description` is the instruction.
        station: where the finger works.
        arm: what carries it.
        dt_s: duration of a control step.
        workspace_m: corners (3,) of the box to which the flange is held, metres.
        action_limits: lowest and highest action (3 + C,).
        clipped: number of commands that were clipped to limits since the reset.
        command: last action after clipping (3 + C,), which acts as late as the station says.
        target_m: where the flange is sent (3,), metres in the station's frame.
        start_width: how much wider than the task's own random starts are, see `widen_starts`.
        out_of_range: number of steps since the reset outside what networks were trained with.
        model, data: MuJoCo's, for planners, experts and tests.
        view: draws the scene, for `render` and scene cameras.
    """

    chambers: int
    pressure_range_kpa: tuple[float, float]
    view: View
    start_width = 0.0

    def __init__(self, task: str, station: Station | None, length_mm: float):
        """Builds the model of a task at a station, the paper's where it is None, for a finger of this length.

        Raises InputError where there is no such task, or the arm's file is wrong.
        """
        self.task, self.station = make_task(task), station or Station()
        self.dt_s, self.arm = self.station.dt_s, self._make_arm()
        limits = action_limits(self.pressure_range_kpa, self.chambers)
        self.action_limits = tuple(limit.astype(float) for limit in limits)
        # Tasks are laid out for the paper's finger: with a longer one the flange keeps as much higher.
        self.workspace_m = self.station.box_m(length_mm)
        self._lift_m = self.workspace_m[0] - self.station.workspace_low_m
        carried = self.arm.body, self.arm.servos, self.station.control_hz
        xml = scene.build(self.task, self._finger_mjcf(), *carried)
        try:
            self.model = self._compiled(xml)
        except InputError:
            raise
        except ValueError as e:  # of MuJoCo
            raise InputError(
                f"MuJoCo does not take what the task '{task}' brings ({' '.join(str(e).split())}); correct"
                " its mjcf, assets and actuators."
            ) from e
        self.data = mujoco.MjData(self.model)
        self._ik, self._base_m = self.arm.solver(), self.arm.base_m
        self._arm = slice(0, self.arm.joints)  # its joints and servos come first in the model
        self._flange, self._gel = self.model.site("flange").id, self.model.site("gel").id
        self._rng = np.random.default_rng()

    def _make_arm(self):
        return self.station.make_arm()

    def _compiled(self, xml: str) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(xml)

    @abstractmethod
    def _finger_mjcf(self) -> scene.Finger:
        """MJCF of the finger that the flange carries."""

    @abstractmethod
    def _advance(self, joints: np.ndarray, drive) -> None:
        """Physics substeps of one control step, towards arm joint targets (N,) rad and a finger's drive."""

    def _start(self) -> None:
        """Draws a start from the random stream: objects, and where the flange is; it is not settled yet.

        Raises InputError where the arm does not reach it.
        """
        mujoco.mj_resetData(self.model, self.data)
        self._lay_out()
        self.target_m = self.home_m + self._rng.uniform(-1, 1, 3) * self._start_half_m
        self.target_m[1] += self._rng.choice(self._starts_m)
        self._ik.reset()
        self._joints = converged(self._ik, self.target_m - self._base_m)
        missing_m = np.linalg.norm(self._ik.pose(self._joints)[1] + self._base_m - self.target_m)
        if missing_m > MISSING_M:
            raise InputError(
                f"The arm falls {missing_m:.2g} m short of {np.round(self.target_m, 3).tolist()} m, where"
                f" the task '{self.task.name}' starts; give the station another base_m or home_rad, or a task"
                " of your own another home_m."
            )
        self.data.qpos[self._arm] = self._joints
        self.clipped = self.out_of_range = 0
        self.command = np.zeros(3 + self.chambers)
        self._queue = deque([self.command] * self._late_commands)

    def _lay_out(self) -> None:
        self.task.reset(self.model, self.data, self._rng)

    @property
    def _starts_m(self) -> tuple[float, ...]:
        return self.task.starts_m

    def _settle(self, drive) -> None:
        for _ in range(self.station.steps(scene.SETTLE_S)):
            self._advance(self._joints, drive)
        self.data.time = 0.0

    def _send(self, action) -> tuple[np.ndarray, np.ndarray]:
        """Takes an action, and gives the one that acts now: joint targets (N,) rad and pressures (C,) kPa.

        Raises InputError where the action has another shape or is not finite.
        """
        self.command = self._clip(checked_action(action, self.chambers))
        self._queue.append(self.command)
        acting = self._queue.popleft()
        wanted = self.target_m + acting[:3] * self.dt_s
        target = np.clip(wanted, *self.workspace_m)
        self.clipped += int(np.any(target != wanted))
        joints = self._ik.solve(target - self._base_m)
        if self._ik.missing_m > MISSING_M:  # it stays where it was, and goes on from there
            self.clipped, target, joints = self.clipped + 1, self.target_m, self._joints
            self._ik.reset(joints)
        self.target_m = target
        return joints, acting[PRESSURES]

    def _clip(self, action: np.ndarray) -> np.ndarray:
        """The action within `action_limits`; counts it where it was beyond."""
        clipped = np.clip(action, *self.action_limits)
        # A float32 action at the limit is not beyond it.
        self.clipped += bool(np.any(np.abs(clipped - action) > 1e-6 * np.maximum(1.0, np.abs(action))))
        return clipped

    @property
    def _late_commands(self) -> int:
        return self.station.late_commands

    def widen_starts(self, width: float) -> None:
        """Makes the starts of hand and objects wider from the next reset on: 0 is the task's own, 1 wide.

        Raises InputError where the width is out of range.
        """
        if not 0 <= width <= MOST_WIDE:
            raise InputError(f"start_width is {width:g}; it must be from 0 to {MOST_WIDE:g}.")
        self.task.widen(width - self.start_width)
        self.start_width = width

    @property
    def _start_half_m(self) -> np.ndarray:
        """Half widths (3,) of the flange's random start."""
        return HOME_JITTER_M + self.start_width * WIDER_M

    @property
    def home_m(self) -> np.ndarray:
        """Where the flange starts (3,) before the random part of it, metres."""
        return np.array(self.station.home_m or self.task.home_m + self._lift_m)

    @property
    def flange_m(self) -> np.ndarray:
        """Flange position (3,), metres."""
        return self.data.site_xpos[self._flange].copy()

    @property
    def gel_m(self) -> np.ndarray:
        """Middle of the gel window on the resting surface (3,), metres."""
        return self.data.site_xpos[self._gel].copy()

    @property
    def time_s(self) -> float:
        """Simulated seconds since the reset."""
        return self.data.time

    @property
    def success(self) -> bool:
        return self.task.success()

    @property
    def failure(self) -> str | None:
        """What has spoilt the trial, or None."""
        return self.task.failure()

    def render(self, width: int = 480, height: int = 360) -> np.ndarray:
        """Picture of the scene with the tactile image in a corner, uint8 (height, width, 3)."""
        return self.view.picture(self.data, self.touch.image, width, height)

    def close(self) -> None:
        self.view.close()


def checked_action(action, chambers: int = 1) -> np.ndarray:
    """The action as float64 (3 + C,) of a finger of C chambers, units of `features.action_names`.

    Raises InputError where it has another shape or is not finite.
    """
    size = 3 + chambers
    what = f"dx, dy, dz in m/s, {'pressure' if chambers == 1 else f'{chambers} pressures'} in kPa"
    try:
        action = np.asarray(action, float)
    except (TypeError, ValueError) as e:
        raise InputError(f"The action must be {size} numbers ({what}): {e}.") from e
    if action.shape != (size,):
        raise InputError(f"The action has shape {action.shape}; it must be ({size},): {what}.")
    if not np.isfinite(action).all():
        raise InputError(f"The action {action.tolist()} is not finite; every entry must be a number.")
    return action


def pad_contacts(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[tuple[Any, np.ndarray]]:
    """Contacts of the gel's pad, and force and torque (6,) of each in its own frame."""
    pad = model.geom("pad").id
    for i in range(data.ncon):
        if pad in (data.contact[i].geom1, data.contact[i].geom2):
            force = np.zeros(6)
            mujoco.mj_contactForce(model, data, i, force)
            yield data.contact[i], force


def imprint_m(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray | None:
    """Centre of pressure in the gel's frame: across and along the finger (2,), metres; None without contact.

    x = sum f_i (x_i - x_gel) / sum f_i over contacts of the pad, f_i their normal forces.
    """
    gel, total, moment = data.site("gel"), 0.0, np.zeros(3)
    for contact, force in pad_contacts(model, data):
        total += force[0]
        moment += force[0] * (contact.pos - gel.xpos)
    return None if total < CONTACT_N else (gel.xmat.reshape(3, 3).T @ moment)[:2] / total
