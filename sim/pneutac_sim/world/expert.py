"""Scripted experts: they find the object by touch, with the variation of a person at a joystick.

An expert is reactive: what it does depends on where the gel is, on the pressure it commanded last and on what
the gel feels, all of which a policy sees too. Nothing but touch tells it where the object is.
"""

from collections.abc import Callable

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.features import MAX_PRESSURE_KPA, action_limits
from pneutac_sim.world.experts import EXPERTS
from pneutac_sim.world.experts.motion import Habits, Wish
from pneutac_sim.world.tasks.base import Task
from pneutac_sim.world.world import World

ACCELERATION = 0.8  # m/s2, how fast a hand changes the velocity


class ScriptedExpert:
    """Demonstrates the world's task; call `action` once a control step, before `world.step`.

    Experts speak of the paper's finger, of 0 to 15 kPa. Another's pressures are as large a share of its own
    range, of its farther end where it bends by vacuum.
    """

    def __init__(self, world: World, rng: np.random.Generator):
        self._world = world
        self._rng = rng
        self._habits = Habits.draw(rng)
        self._velocity = np.zeros(3)
        self._pressure = self._habits.low_kpa
        self._expert = _expert_of(world)
        self._limits = action_limits(world.pressure_range_kpa)
        self._scale = max(world.pressure_range_kpa, key=abs) / MAX_PRESSURE_KPA

    def action(self) -> np.ndarray:
        """Next action (4,) float32 as `features.ACTION_NAMES`, within its limits; holds still when done."""
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
        action = np.append(self._velocity + noise, self._scale * self._pressure)
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
