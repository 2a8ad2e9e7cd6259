"""Scripted experts: they find the object by touch, with the variation of a person at a joystick.

Before the touch an expert searches along lanes that depend on where the gel is alone, at low pressure; after
it, it acts on what the gel feels: inflates while it presses, retreats when the force drops. Nothing but touch
tells it where the object is, so a policy that sees position, pressure, touch and its previous action can
imitate it.
"""

import numpy as np

from pneutac_sim.features import ACTION_HIGH, ACTION_LOW
from pneutac_sim.world.experts import SCRIPTS
from pneutac_sim.world.experts.motion import Habits
from pneutac_sim.world.world import DT, World

ACCELERATION = 0.5  # m/s2, how fast a hand changes the velocity


class ScriptedExpert:
    """Demonstrates the world's task; call `action` once a control step, before `world.step`.

    Attributes:
        done: the script has ended; further actions hold still.
    """

    def __init__(self, world: World, rng: np.random.Generator):
        self._world = world
        self._rng = rng
        self._habits = Habits.draw(rng)
        self._velocity = np.zeros(3)
        self._pressure = world.pressure_kpa
        self._script = SCRIPTS[world.task.name](world, self._habits)
        self.done = False

    def action(self) -> np.ndarray:
        """Next action (4,) float32 as `features.ACTION_NAMES`, within its limits."""
        wish, pressure = np.zeros(3), self._pressure
        if not self.done:
            try:
                wish, pressure = next(self._script)
            except StopIteration:
                self.done = True
        change = wish - self._velocity
        limit = ACCELERATION * DT
        self._velocity += change * min(1.0, limit / max(np.linalg.norm(change), 1e-9))
        ramp = self._habits.ramp_kpa_s * DT
        self._pressure += np.clip(pressure - self._pressure, -2 * ramp, ramp)
        noise = self._rng.normal(0, self._habits.tremor, 3) if np.any(wish) else 0.0
        action = np.append(self._velocity + noise, self._pressure)
        return np.clip(action, ACTION_LOW, ACTION_HIGH).astype(np.float32)
