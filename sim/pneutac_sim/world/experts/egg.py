"""Open the carton: touch its front wall, slide up along it, and so lift the lid's tab off the latch."""

import numpy as np

from pneutac_sim.world.experts.motion import VENTED_KPA, Habits, Lanes, Wish, touching
from pneutac_sim.world.tasks.egg import EggTask
from pneutac_sim.world.world import World

EDGE_M = EggTask().edge_m
# Lanes are less apart than gel and tab are wide; the wall is touched below the lid's edge.
LANES = Lanes(height_m=EDGE_M - 0.02, rise_m=0.030, middles_m=EggTask.starts_m, back_m=0.425)
# A wall meets a corner of the gel, which yields to little: it is pressed by force.
SLIDES_N, PRESS_N = 0.35, 0.5  # on the wall: from which it goes up; while it begins to
SLIDE_N = 0.7  # while it slides up, lest it slips past the tab
PAST_M = 0.012  # gel above the lid's edge when it has slid past it, and past the tab


def open_carton(world: World, habits: Habits, pressure: float) -> Wish:
    """What to do now; `pressure` is the one commanded last, kPa."""
    z = world.gel_m[2]
    past = z > EDGE_M + PAST_M
    if past or pressure < VENTED_KPA and not LANES.begins(world):
        return LANES.withdraw(world, past), 0.0
    if touching(world) or z > EDGE_M - 0.008:
        sliding = z > EDGE_M - 0.016
        missing = (SLIDE_N if sliding else PRESS_N) - world.press_n
        ahead = np.clip(0.15 * missing, -0.01, 0.025)
        up = 0.06 * (sliding or world.press_n > SLIDES_N)
        return habits.speed * np.array([ahead, 0.0, up]) + LANES.keep(world), habits.low_kpa
    return LANES.ahead(world, habits, 0.07), habits.low_kpa
