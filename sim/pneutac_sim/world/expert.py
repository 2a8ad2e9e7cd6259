"""Scripted experts: closed loop on the world's truth, with the variation of a person at a joystick.

An expert's behaviour can be read off its observation: it approaches at low pressure along a path that
depends on the flange's position, presses on when it touches, inflates while it presses, and retreats inflated
when the object has moved. So a policy that sees position, pressure, touch and its previous action can imitate
it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pneutac_sim.features import ACTION_HIGH, ACTION_LOW
from pneutac_sim.world.world import DT, World

ACCELERATION = 0.25  # m/s2, how fast a hand changes the velocity
TOUCH_MM = 0.4  # imprint from which on a touch is seen in the tactile image: about 0.4 N

Script = Iterator[tuple[np.ndarray, float]]  # yields wished velocity (3,) m/s and pressure kPa


@dataclass
class Habits:
    """How one person acts in one episode, drawn anew each time.

    Attributes:
        speed: factor on all speeds.
        offset_m: error of the aimed path (3,), metres.
        low_kpa, high_kpa: pressures of approach and of manipulation.
        ramp_kpa_s: how fast the pressure is turned up.
        pause_s: hesitation after the first touch.
        overshoot_s: how long the motion goes on after the object has moved.
        tremor: standard deviation of the velocity's noise, m/s.
    """

    speed: float
    offset_m: np.ndarray
    low_kpa: float
    high_kpa: float
    ramp_kpa_s: float
    pause_s: float
    overshoot_s: float
    tremor: float = 0.0015

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Habits":
        """A person's habits for one episode."""
        return cls(
            speed=rng.uniform(0.8, 1.25),
            offset_m=rng.uniform(-1, 1, 3) * (0.0, 0.004, 0.002),
            low_kpa=rng.uniform(2.5, 4.0),
            high_kpa=rng.uniform(11.0, 13.5),
            ramp_kpa_s=rng.uniform(7.0, 12.0),
            pause_s=rng.choice([0.0, 0.0, rng.uniform(0.05, 0.25)]),
            overshoot_s=rng.uniform(0.0, 0.2),
        )


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


def _go(world: World, goal: np.ndarray, speed: float, pressure: float) -> Script:
    """Brings the flange to `goal`, slowing down over the last centimetres."""
    while np.linalg.norm(way := goal - world.flange_m) > 0.004:
        yield speed * way / max(np.linalg.norm(way), 0.02), pressure


def _touching(world: World) -> bool:
    return world.press_mm > TOUCH_MM


def _hold(seconds: float, pressure: float) -> Script:
    for _ in range(round(seconds / DT)):
        yield np.zeros(3), pressure


def _approach(world: World, habits: Habits, gel_goal: np.ndarray, stop: Callable[[], bool]) -> Script:
    """Brings the gel to the line through `gel_goal` along x, then along it until `stop`."""
    speed = 0.05 * habits.speed
    line = gel_goal + habits.offset_m
    while not stop():
        way = line - world.gel_m
        way[0] = 0.025  # always ahead
        yield speed * way / np.linalg.norm(way), habits.low_kpa


def flip_switch(world: World, habits: Habits) -> Script:
    """Touch the bar, inflate while pushing until it snaps over, retreat inflated and hold."""
    task, bar = world.task, world.data.geom("bar")
    level = np.array([0.0, 0.0, 0.118])
    back = np.array([-0.06, 0.0, 0.02])
    while task.lever_rad < 0.5 * task.well_rad:
        yield from _approach(world, habits, level, lambda: _touching(world))
        yield from _hold(habits.pause_s, habits.low_kpa)
        lost = 0
        while task.lever_rad < 0.5 * task.well_rad and lost < 8:
            lost = 0 if _touching(world) else lost + 1
            slip = bar.xpos - world.gel_m
            yield habits.speed * np.array([0.02, 0.8 * slip[1], 3.0 * slip[2]]), habits.high_kpa
        if task.lever_rad < 0.5 * task.well_rad:
            yield from _go(world, world.flange_m + back, 0.06, habits.low_kpa)
    for _ in range(round(habits.overshoot_s / DT)):
        yield habits.speed * np.array([0.02, 0.0, 0.0]), habits.high_kpa
    yield from _go(world, world.flange_m + back, 0.06 * habits.speed, habits.high_kpa)
    while not world.success:
        yield np.zeros(3), habits.high_kpa


def open_carton(world: World, habits: Habits) -> Script:
    """Touch the lid's edge, go below it while inflating, come up under it and lift along the lid's arc."""
    task, hinge, carton = world.task, world.data.body("lid"), world.data.body("carton")

    def under(along_m: float, below_m: float, ahead_rad: float = 0.0) -> np.ndarray:
        """Point `along_m` inside the lid's edge and `below_m` under it, the lid opened a little further."""
        c, s = np.cos(task.lid_rad + ahead_rad), np.sin(task.lid_rad + ahead_rad)
        x, z = along_m - task.reach_m, -below_m
        return hinge.xpos + carton.xmat.reshape(3, 3) @ [c * x + s * z, 0.0, -s * x + c * z]

    def towards(goal: np.ndarray) -> np.ndarray:
        way = goal - world.gel_m
        way[1] = 0.0
        return 0.06 * habits.speed * way / max(np.linalg.norm(way), 0.015)

    level = np.array([0.0, 0.0, task.edge_m])
    yield from _approach(world, habits, level, lambda: _touching(world))
    yield from _hold(habits.pause_s, habits.low_kpa)
    while world.pressure_kpa < habits.high_kpa - 0.5 or world.gel_m[2] > task.edge_m - 0.016:
        yield towards(under(-0.008, 0.022)), habits.high_kpa
    while world.press_mm < 0.25 and task.lid_rad < 0.1:
        yield towards(under(0.006, -0.002)), habits.high_kpa
    while not world.success:
        yield towards(under(0.006, 0.0, ahead_rad=0.2)), habits.high_kpa


def pull_card(world: World, habits: Habits) -> Script:
    """Touch the front card, inflate to press it lightly, draw it out along the holder's lean."""
    task = world.task
    c, s = np.cos(task.lean_rad), np.sin(task.lean_rad)
    draw, into = np.array([-s, 0.0, c]), np.array([c, 0.0, s])
    press_kpa = 0.65 * habits.high_kpa
    level = np.array([0.0, 0.0, task.middle_m])
    yield from _approach(world, habits, level, lambda: world.press_mm > 0.1)
    yield from _hold(habits.pause_s, habits.low_kpa)
    while not world.success:
        error = 0.65 - world.press_mm
        speed = 0.04 * habits.speed * np.clip(1 - 4 * abs(error), 0, 1)
        yield speed * draw + 0.12 * np.clip(error, -0.2, 0.2) * into, press_kpa


SCRIPTS: dict[str, Callable[[World, Habits], Script]] = {
    "switch": flip_switch,
    "egg": open_carton,
    "card": pull_card,
}
