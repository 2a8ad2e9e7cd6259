"""What a task brings to the world: MJCF, a random start, and when it is done or spoilt."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

BUMP_S = 1 / 15  # a force that lasts no longer is no press
HOME_JITTER_M = 0.004  # half width of the random start of the flange about a task's home
WIDER_M = np.array([0.012, 0.014, 0.010])  # by how much wider along x, y and z a start of width 1 is

Wish = tuple[np.ndarray, float]  # velocity (3,) m/s and pressure kPa


@dataclass
class Habits:
    """How one person acts in one episode, newly drawn each time."""

    speed: float  # factor on all speeds
    offset_m: float  # error of the height at which it searches, metres
    # low_kpa, high_kpa: pressures of search and of manipulation
    low_kpa: float
    high_kpa: float
    ramp_kpa_s: float  # how fast the pressure is turned up
    tremor: float = 0.003  # standard deviation of the velocity's noise, m/s

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Habits:
        return cls(
            speed=rng.uniform(0.85, 1.15),
            offset_m=rng.uniform(-1, 1) * 0.0015,
            low_kpa=rng.uniform(2.75, 3.5),
            high_kpa=rng.uniform(11.0, 13.0),
            ramp_kpa_s=rng.uniform(8.0, 12.0),
        )


@dataclass(frozen=True)
class Goal:
    """A task as the reward of reinforcement learning sees it."""

    # how much is done, 0 at the start and 1 at success; less than 0 where it goes wrong
    progress: Callable[[Task], float]
    geom: str  # the part of the object that the gel is to touch
    # of that part, in its own frame: corner of the unit cube (3,), times the geom's half sizes
    side: tuple[float, float, float]
    depth_mm: float  # imprint that does the task well


def share(done: float) -> float:
    """At least 0 and at most 1; NumPy's `clip` of one number takes ten times as long."""
    return min(max(float(done), 0.0), 1.0)


class Task:
    """One manipulation task. A subclass sets the class attributes and the methods that it needs.

    Geoms that the gel can feel carry `class="object"`; the scene puts them into a group of their own.
    """

    name: str  # as in `pneutac_sim/<name>`
    description: str  # the instruction in plain words, as stored with demonstrations
    home_m: tuple[float, float, float]  # flange position (3,) at the start of an episode, metres
    starts_m: tuple[float, ...] = (0.0,)  # displacements from there along y, one of which a random start has
    # what `pneutac ppo` learns by, with an object whose outermost body has the task's name; None where it
    # cannot be learnt so
    goal: Goal | None = None
    # attributes of the random start to how much larger they are in starts of width 1
    wider: ClassVar[dict[str, float]] = {}
    too_hard = ""  # what spoils the trial where the least of the forces `lately` is above `limit_n`
    limit_n = math.inf
    _force = (0.0, 0.0)

    def widen(self, width: float) -> None:
        """Makes the random start wider, see `wider`."""
        for name, more in self.wider.items():
            setattr(self, name, getattr(self, name) + width * more)

    def assets(self) -> str:
        """MJCF assets that the objects name, such as meshes; a file's path there is absolute."""
        return ""

    def expert(self, world: Any, habits: Habits, pressure_kpa: float) -> Wish:
        """What a scripted demonstrator does now; optional.

        Args:
            world: `World` as it is; a person feels `press_mm` and `imprint_m`, and sees `gel_m`, `flange_m`.
            habits: how this one person moves.
            pressure_kpa: commanded last; of the paper's finger, 0 to 15, whatever the range of the twin's.

        Returns:
            Velocity (3,) in m/s and pressure in kPa as above.
        """
        raise NotImplementedError

    def mjcf(self) -> str:
        """MJCF bodies of the task's objects."""
        raise NotImplementedError

    def actuators(self) -> str:
        """MJCF actuators that the task's objects need; their control is set in `reset`."""
        return ""

    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Draws the start from `rng`: object poses into the model, joint angles into the data."""
        raise NotImplementedError

    def update(self, model: mujoco.MjModel, data: mujoco.MjData, dt: float) -> None:
        """Called after every control step of `dt` seconds."""
        raise NotImplementedError

    def success(self) -> bool:
        """Whether the task is done."""
        raise NotImplementedError

    def failure(self) -> str | None:
        """What has spoilt the trial, in a few words, or None."""
        if min(self._force) > self.limit_n:  # a bump of a moment is no press
            return f"{self.too_hard} with more than {self.limit_n:g} N"
        return None


def place(model: mujoco.MjModel, body: str, position, yaw: float, pivot_m: float = 0.0) -> None:
    """Moves a fixed body of the model: `position` (3,) m, `yaw` rad about the vertical.

    The axis goes through the body's point (`pivot_m`, 0), so a yaw leaves that part where it is.
    """
    b, c, s = model.body(body), np.cos(yaw), np.sin(yaw)
    b.pos[:] = np.add(position, (pivot_m * (1 - c), -pivot_m * s, 0.0))
    b.quat[:] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)


def lately(forces: tuple[float, ...], force: float, dt: float) -> tuple[float, ...]:
    """The forces (N) of the last `BUMP_S` and the present one; the least of them was there all the time."""
    return (*forces, force)[-math.ceil(BUMP_S / dt - 1e-6) - 1 :]


def contact_force(model: mujoco.MjModel, data: mujoco.MjData, prefix: str | tuple[str, ...]) -> float:
    """Sum of normal forces (N) between the finger and geoms whose name starts with `prefix`."""
    total, force = 0.0, np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        pair = (contact.geom1, contact.geom2)
        finger = any(model.geom_contype[g] == 1 for g in pair)
        if finger and any(model.geom(g).name.startswith(prefix) for g in pair):
            mujoco.mj_contactForce(model, data, i, force)
            total += force[0]
    return total
