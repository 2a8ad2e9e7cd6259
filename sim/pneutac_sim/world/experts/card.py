"""Pull one card: touch the deck, press lightly, draw along the lean while keeping the pressing force."""

import numpy as np

from pneutac_sim.world.experts.motion import SEARCH_KPA, Habits, Wish, go_ahead, pressed, touching
from pneutac_sim.world.tasks.card import CardTask
from pneutac_sim.world.world import World

LEAN_RAD = CardTask().lean_rad
MIDDLE_M = CardTask().middle_m - 0.003  # the card creeps down the gel while it is drawn
PRESS = 0.95  # while drawing, see `pressed`
DRAW = np.array([-np.sin(LEAN_RAD), 0.0, np.cos(LEAN_RAD)])
INTO = np.array([np.cos(LEAN_RAD), 0.0, np.sin(LEAN_RAD)])


def pull_card(world: World, habits: Habits, pressure: float) -> Wish:
    """What to do now; `pressure` is the one commanded last, kPa."""
    if not touching(world) and pressure < SEARCH_KPA:
        return go_ahead(world, habits, MIDDLE_M, 0.06), habits.low_kpa
    error = PRESS - pressed(world)
    speed = 0.04 * habits.speed * np.clip(1 - 4 * abs(error), 0, 1)
    return speed * DRAW + 0.12 * np.clip(error, -0.2, 0.2) * INTO, 0.65 * habits.high_kpa
