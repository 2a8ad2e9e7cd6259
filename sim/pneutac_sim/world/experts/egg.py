"""Open the carton: touch its front wall, slide up until the lid's tab is felt, lift along the lid's arc."""

import numpy as np

from pneutac_sim.world.experts.motion import SEARCH_KPA, VENTED_KPA, Habits, Lanes, Wish, touching
from pneutac_sim.world.tasks.egg import EggTask
from pneutac_sim.world.world import World

EDGE_M, REACH_M = EggTask().edge_m, EggTask().reach_m
# Lanes are less apart than gel and tab are wide; the wall is touched below the lid's edge.
LANES = Lanes(height_m=EDGE_M - 0.02, rise_m=0.035, middles_m=EggTask.starts_m, back_m=0.44)
# A flat wall shows nothing but the gel's edge, and only when it is pressed harder than a bar.
SHOWN_MM, PRESS_MM = 0.45, 0.65  # imprints of the wall: the least that a camera shows; before it slides up
SLIDE_MM = 0.45  # while it slides up, lightly, lest it misses the tab
TAB_M = 0.007  # imprints nearer to the gel's end are of the wall
PAST_M = 0.012  # gel above the lid's edge when it has slid past it
OPEN_M = 0.105  # and when it has lifted the lid, or missed it


def open_carton(world: World, habits: Habits, pressure: float) -> Wish:
    """What to do now; `pressure` is the one commanded last, kPa."""
    z, at = world.gel_m[2], world.imprint_m
    lifting = pressure > SEARCH_KPA
    past = z > EDGE_M + (OPEN_M if lifting else PAST_M)
    if pressure < VENTED_KPA and not LANES.begins(world):
        return LANES.withdraw(world, past), 0.0
    hooked = touching(world) and at is not None and at[1] < TAB_M
    if past and not hooked or past and lifting:
        return np.zeros(3), 0.0
    if hooked or lifting:
        return _lift(world, habits, pressure, at)
    if touching(world) or z > EDGE_M - 0.008:
        sliding = z > EDGE_M - 0.016
        ahead = np.clip(0.15 * ((SLIDE_MM if sliding else PRESS_MM) - world.press_mm), -0.01, 0.02)
        up = 0.06 * (sliding or world.press_mm > SHOWN_MM)
        return habits.speed * np.array([ahead, 0.0, up]), habits.low_kpa
    return LANES.ahead(world, habits, 0.08), habits.low_kpa


def _lift(world: World, habits: Habits, pressure: float, at: np.ndarray | None) -> Wish:
    """Inflate with the tab in the middle of the gel, then lift along the lid's arc."""
    across = 0.0 if at is None or at[1] > TAB_M else at[0]
    aside = np.array([0.0, -3.0 * across, 0.0])
    full = np.clip((pressure - habits.low_kpa) / (habits.high_kpa - habits.low_kpa), 0, 1)
    if at is None and full < 0.5:  # the tab lies on what is not gel
        return np.array([-0.01, 0.0, 0.03]), habits.high_kpa
    if abs(across) > 0.005 and full < 1:
        return aside, habits.high_kpa
    rise = np.clip((world.gel_m[2] - EDGE_M) / REACH_M, 0, 0.95)
    lift = 0.06 * full * np.array([rise, 0.0, np.sqrt(1 - rise**2)])
    return habits.speed * (lift + aside), habits.high_kpa
