"""What the experts' scripts share: habits of a person, what the gel feels, and simple motions."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from pneutac_sim.world.world import DT, World

TOUCH_MM = 0.12  # imprint that is seen as a touch, about 0.12 N

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
            offset_m=rng.uniform(-1, 1, 3) * (0.0, 0.002, 0.0015),
            low_kpa=rng.uniform(2.5, 4.0),
            high_kpa=rng.uniform(11.0, 13.5),
            ramp_kpa_s=rng.uniform(7.0, 12.0),
            pause_s=rng.choice([0.0, 0.0, rng.uniform(0.05, 0.25)]),
            overshoot_s=rng.uniform(0.0, 0.2),
        )


def touching(world: World, least_mm: float = TOUCH_MM) -> bool:
    """Whether the gel shows a touch."""
    return world.press_mm > least_mm


def imprint_m(world: World) -> np.ndarray | None:
    """Where the gel is pressed, in the gel's frame: across and along the finger (2,), metres; None where not.

    Along is positive towards the tip. The tactile image shows the same.
    """
    model, data = world.model, world.data
    pad, total, moment, force = model.geom("pad").id, 0.0, np.zeros(3), np.zeros(6)
    for i in range(data.ncon):
        if pad in (data.contact[i].geom1, data.contact[i].geom2):
            mujoco.mj_contactForce(model, data, i, force)
            total += force[0]
            moment += force[0] * (data.contact[i].pos - world.gel_m)
    if total < 0.02:
        return None
    return (data.site("gel").xmat.reshape(3, 3).T @ moment)[:2] / total


def hold(seconds: float, pressure: float) -> Script:
    """Stays where it is."""
    for _ in range(round(seconds / DT)):
        yield np.zeros(3), pressure


def go(world: World, goal: np.ndarray, speed: float, pressure: float) -> Script:
    """Brings the flange to `goal` (3,), slowing down over the last centimetres."""
    while np.linalg.norm(way := goal - world.flange_m) > 0.004:
        yield speed * way / max(np.linalg.norm(way), 0.02), pressure


def advance(world: World, habits: Habits, lane: np.ndarray, speed: float, stop: Callable[[], bool]) -> Script:
    """Brings the gel to the line along x through `lane` (3,), then ahead along it until `stop`.

    It depends on where the gel is alone: nothing before the touch knows where the object is.
    """
    while not stop():
        way = lane + habits.offset_m - world.gel_m
        way[0] = 0.025  # always ahead
        yield speed * habits.speed * way / np.linalg.norm(way), habits.low_kpa
