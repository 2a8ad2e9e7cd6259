"""Pull one card: touch the deck, press lightly, draw along the lean while keeping the pressing force."""

import numpy as np

from pneutac_sim.world.experts.motion import Habits, Script, advance, hold, touching
from pneutac_sim.world.world import World

PRESS_MM = 0.65  # imprint while drawing


def pull_card(world: World, habits: Habits) -> Script:
    """Touch the front card, inflate to press it lightly, draw it out along the holder's lean."""
    task = world.task
    c, s = np.cos(task.lean_rad), np.sin(task.lean_rad)
    draw, into = np.array([-s, 0.0, c]), np.array([c, 0.0, s])
    press_kpa = 0.65 * habits.high_kpa
    lane = np.array([0.0, 0.0, task.middle_m])
    yield from advance(world, habits, lane, 0.06, lambda: touching(world))
    yield from hold(habits.pause_s, habits.low_kpa)
    while not world.success:
        error = PRESS_MM - world.press_mm
        speed = 0.04 * habits.speed * np.clip(1 - 4 * abs(error), 0, 1)
        yield speed * draw + 0.12 * np.clip(error, -0.2, 0.2) * into, press_kpa
