"""Pull one card: touch the deck, press lightly, draw along the lean while keeping the pressing force."""

import numpy as np

from pneutac_sim.world.experts.motion import (
    FAST_M_S,
    NEAR_M,
    SEARCH_KPA,
    VENTED_KPA,
    Habits,
    Wish,
    go_ahead,
    touching,
)
from pneutac_sim.world.tasks.card import CardTask
from pneutac_sim.world.world import World

LEAN_RAD = CardTask().lean_rad
MIDDLE_M = CardTask().middle_m - 0.015
SLIPPED_M = MIDDLE_M + 0.045  # the gel has slipped over the card's edge
BACK_M = 0.41  # flange where another try begins
PRESS_MM = 0.65  # imprint while drawing
DRAW = np.array([-np.sin(LEAN_RAD), 0.0, np.cos(LEAN_RAD)])
INTO = np.array([np.cos(LEAN_RAD), 0.0, np.sin(LEAN_RAD)])


def pull_card(world: World, habits: Habits, pressure: float) -> Wish:
    """What to do now; `pressure` is the one commanded last, kPa."""
    if pressure < VENTED_KPA and not (world.flange_m[0] < BACK_M and world.gel_m[2] < MIDDLE_M + NEAR_M):
        return _withdraw(world), 0.0
    if not touching(world) and world.gel_m[2] > SLIPPED_M:
        return np.zeros(3), 0.0
    if not touching(world) and pressure < SEARCH_KPA:
        return go_ahead(world, habits, MIDDLE_M, 0.06), habits.low_kpa
    error = PRESS_MM - world.press_mm
    speed = 0.04 * habits.speed * np.clip(1 - 4 * abs(error), 0, 1)
    return speed * DRAW + 0.12 * np.clip(error, -0.2, 0.2) * INTO, 0.65 * habits.high_kpa


def _withdraw(world: World) -> np.ndarray:
    """Velocity (3,) back to the near side, and down there."""
    return FAST_M_S * np.array([-1.0, 0.0, 0.0] if world.flange_m[0] > BACK_M else [0.0, 0.0, -1.0])
