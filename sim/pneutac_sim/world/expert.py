"""Scripted experts: they find the object by touch, with the variation of a person at a joystick.

An expert is reactive: what it does depends on where the gel is, on the pressure it commanded last and on what
the gel feels, all of which a policy sees too. Nothing but touch tells it where the object is.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from pneutac_sim.errors import InputError
from pneutac_sim.features import MAX_PRESSURE_KPA, action_limits
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import PAPER_FINGER, Twin
from pneutac_sim.world.experts import EXPERTS
from pneutac_sim.world.experts.motion import Habits, Wish
from pneutac_sim.world.tasks.base import Task
from pneutac_sim.world.world import World

PAPER_JOINTS = 4
GAIN_RAD_PER_KPA, REST_KPA = PAPER_FINGER["gain_rad_per_kpa"], PAPER_FINGER["rest_pressure_kpa"]
ACCELERATION = 0.8  # m/s2, how fast a hand changes the velocity


class ScriptedExpert:
    """Demonstrates the world's task; call `action` once a control step, before `world.step`.

    Experts speak of the paper's finger, of 0 to 15 kPa. Another's pressures are as large a share of its own
    range, of its farther end where it bends by vacuum. Several chambers bend the body as far as the paper's
    finger would be bent, which is curled at 0 kPa already, or as far as they can.

    Args:
        world: whose task is demonstrated.
        rng: draws the habits and the tremor of the hand.
        tremor: whether the hand trembles.
    """

    def __init__(self, world: World, rng: np.random.Generator, tremor: bool = True):
        self._world = world
        self._rng = rng
        self._habits = Habits.draw(rng)
        if not tremor:
            self._habits = replace(self._habits, tremor=0.0)
        self._velocity = np.zeros(3)
        self._pressure = self._habits.low_kpa
        self._expert = _expert_of(world)
        self._limits = action_limits(world.pressure_range_kpa, world.chambers)
        self._pressures = pressures_of(world)

    def action(self) -> np.ndarray:
        """Next action (3 + C,) float32 as `features.action_names`, within its limits; rests when done."""
        wish, pressure = np.zeros(3), self._pressure
        if not self._world.success:
            wish, pressure = self._expert(self._world, self._habits, self._pressure)
        change = wish - self._velocity
        limit = ACCELERATION * self._world.dt_s
        self._velocity += change * min(1.0, limit / max(np.linalg.norm(change), 1e-9))
        # Only inflating takes care: the valve vents, and fills to the pressure of the search, at once.
        ramp = max(self._pressure + self._habits.ramp_kpa_s * self._world.dt_s, self._habits.low_kpa)
        self._pressure = min(pressure, ramp)
        noise = self._rng.normal(0, self._habits.tremor, 3) if np.any(wish) else 0.0
        action = np.append(self._velocity + noise, self._pressures(self._pressure))
        return np.clip(action, *self._limits).astype(np.float32)


def _expert_of(world: World) -> Callable[..., Wish]:
    """The library's expert of a task, or the task's own."""
    task = getattr(world.task, "inner", world.task)  # a `VariedWorld` wraps it
    if task.name in EXPERTS:
        return EXPERTS[task.name]
    if type(task).expert is Task.expert:
        raise InputError(
            f"The task '{task.name}' has no scripted expert; give its class a method `expert`, or record"
            " by hand with --teleop.type=pneutac_keyboard or pneutac_gamepad."
        )
    return task.expert


def pressures_of(world: World) -> Callable[[float], np.ndarray]:
    """What the chambers (C,) are commanded in kPa for an expert's pressure: see `ScriptedExpert`."""
    far = max(world.pressure_range_kpa, key=abs)
    if world.chambers == 1:
        return lambda pressure: np.array([far / MAX_PRESSURE_KPA * pressure])
    full, reach_rad = towards_gel(world.twin, far)

    def of(pressure: float) -> np.ndarray:
        bend_rad = PAPER_JOINTS * GAIN_RAD_PER_KPA * (pressure + REST_KPA)
        return min(bend_rad / reach_rad, 1.0) * full

    return of


def towards_gel(twin: Twin, far_kpa: float) -> tuple[np.ndarray, float]:
    """Pressures of several chambers that bend a body towards its gel, +z, and to no other side.

    With the directions d_c of the pipeline's drive, sum of p_c d_c = (b, 0) with p >= 0 (p <= 0 if it bends
    by vacuum) and no more chambers than that takes.

    Args:
        twin: of an arm.
        far_kpa: the highest of the pressures.

    Returns:
        (C,) kPa, and by how much they bend it, rad.

    Raises:
        InputError: its chambers bend it so by no pressures.
    """
    pipeline = Pipeline.of(twin)
    gain = pipeline.chain[pipeline.drive].held_at(pipeline.theta(twin)).gain  # (C, 2 N) rad/kPa
    gain = np.sign(far_kpa) * gain.reshape(len(gain), -1, 2).sum(1)
    share, missing = nnls(gain.T, np.array([1.0, 0.0]))
    if missing > 1e-6:
        raise InputError(
            "No pressures of the twin's chambers bend it towards its gel, +z, alone; calibrate the twin,"
            " whose chamber_angle_rad and gains tell the directions."
        )
    full = far_kpa * share / share.max()
    return full, float(np.abs(full) @ gain[:, 0])
