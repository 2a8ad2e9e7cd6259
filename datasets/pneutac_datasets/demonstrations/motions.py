"""Motions of the arm with the finger against a bar, in any world with the task `button`.

Pressures are those of the paper's finger; another's are as large a share of its range, as of an expert's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from pneutac_sim.errors import InputError
from pneutac_sim.features import CONTROL_HZ, PRESSURES
from pneutac_sim.world.expert import pressures_of
from pneutac_sim.world.tasks.button import DRAG_M_S, HIGH_M

TASK = "button"
SEARCH_KPA, LIGHT_KPA, PRESS_KPA, TOUCH_MM, LONGEST = 2.0, 4.0, 9.0, 0.3, 400
CHATTER = 3  # frames of a rigid contact, over which forces are averaged
LEFT_OUT_S = 1.0  # after the touch, in which the finger is filled


@dataclass(frozen=True, eq=False)
class Motion:
    """What the arm does once the finger touches.

    Attributes:
        name: of it.
        actions: (n, 4) velocity of the flange m/s and pressure of the paper's finger kPa, at `CONTROL_HZ`.
        drag_mm: how far it drags the finger sideways, to both sides.
    """

    name: str
    actions: np.ndarray
    drag_mm: float = 0.0

    @property
    def seconds(self) -> float:
        return len(self.actions) / CONTROL_HZ


@dataclass(frozen=True, eq=False)
class Felt:
    """What happened in a motion, from a second after the touch on.

    Attributes:
        force_n: (T,) on the gel.
        turn_deg: (T,) of the bar in the gel's frame.
        way_mm: (T,) of the flange sideways.
    """

    force_n: np.ndarray
    turn_deg: np.ndarray
    way_mm: np.ndarray

    @property
    def time_s(self) -> np.ndarray:
        """(T,) seconds since the touch."""
        return LEFT_OUT_S + np.arange(len(self.force_n)) / CONTROL_HZ

    @property
    def turn_deg_per_mm(self) -> float:
        """Least-squares turn by the way sideways; 0 where there is none."""
        way = self.way_mm - self.way_mm.mean()
        return float(way @ self.turn_deg / (way @ way)) if np.ptp(way) > 1.0 else 0.0


def held(seconds: float, kpa: float = PRESS_KPA, velocity=(0.0, 0.0, 0.0)) -> list[np.ndarray]:
    """Actions that hold a pressure and a velocity for a time."""
    return [np.array([*velocity, kpa])] * round(seconds * CONTROL_HZ)


def sideways(drag_mm: float, kpa: float = PRESS_KPA) -> Motion:
    """Holds, then drags to one side, the other, and back to the first."""
    there, v = 1e-3 * drag_mm / DRAG_M_S, DRAG_M_S
    actions = (
        held(2, kpa)
        + held(there, kpa, (0, v, 0))
        + held(2 * there, kpa, (0, -v, 0))
        + held(2 * there, kpa, (0, v, 0))
    )
    how = "press" if kpa >= PRESS_KPA else "press lightly" if kpa > SEARCH_KPA else "just touch"
    return Motion(f"{how} and drag sideways by {drag_mm:g} mm", np.array(actions), drag_mm)


PRESS = Motion("press and hold", np.array(held(6)))
MOTIONS = (
    PRESS,
    Motion("three steps of pressure, each held", np.array(held(2, 6.0) + held(2) + held(2, 12.0))),
    Motion(
        "three steps of the arm, each held",
        np.array(held(2) + 3 * (held(0.5, velocity=(0.01, 0, 0)) + held(2))),
    ),
    Motion(
        "drag along the finger",
        np.array(
            held(2)
            + held(1, velocity=(0, 0, 0.004))
            + held(2, velocity=(0, 0, -0.004))
            + held(2, velocity=(0, 0, 0.004))
        ),
    ),
)


def carried_out(world, seed: int, motion: Motion) -> Felt:
    """What is felt in a motion, from where the finger has found the bar.

    Args:
        world: with the task `button`; `World`'s senses are asked of it alone.
        seed: of the scene.
        motion: to carry out.

    Raises:
        InputError: the finger does not reach the bar.
    """
    world.reset(seed)
    pressures: Callable[[float], np.ndarray] = pressures_of(world)
    for _ in range(LONGEST):
        if world.press_mm > TOUCH_MM:
            break
        up = np.clip(1.5 * (HIGH_M - world.gel_m[2]), -0.04, 0.04)
        world.step(np.array([0.04, 0.0, up, *pressures(SEARCH_KPA)]))
    else:
        raise InputError(f"The finger does not find the bar of '{TASK}' in this world; no motion was tried.")
    force, turn, way = [], [], []
    for action in motion.actions:
        world.step(np.append(action[:3], pressures(float(action[PRESSURES][0]))))
        bar = world.data.site("gel").xmat.reshape(3, 3)[1]
        force.append(world.press_n)
        turn.append((np.degrees(np.arctan2(bar[1], bar[0])) + 90) % 180 - 90)
        way.append(1e3 * world.flange_m[1])
    after = slice(round(LEFT_OUT_S * CONTROL_HZ), None)
    smooth = uniform_filter1d(np.array(force), CHATTER)
    return Felt(smooth[after], np.array(turn)[after], np.array(way)[after])
