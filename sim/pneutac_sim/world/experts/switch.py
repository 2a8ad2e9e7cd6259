"""Flip the switch: search lane by lane, press on where it touches, let go when the touch is gone."""

import numpy as np

from pneutac_sim.world.experts.motion import SEARCH_KPA, VENTED_KPA, Habits, Lanes, Wish, touching
from pneutac_sim.world.tasks.switch import SwitchTask
from pneutac_sim.world.world import World

# Lanes are nearer to each other than gel and bar together are wide, so that the bar is never between two.
LANES = Lanes(height_m=0.118, rise_m=0.04, middles_m=SwitchTask.starts_m, back_m=0.415)
END_M = 0.512  # flange where the gel is behind the farthest bar
CENTRE_ACROSS_HZ, CENTRE_ALONG_HZ = 4.5, 3.0  # how fast it centres the imprint; the bar is lost to the side


def flip_switch(world: World, habits: Habits, pressure: float) -> Wish:
    """What to do now; `pressure` is the one commanded last, kPa."""
    x = world.flange_m[0]
    if pressure < VENTED_KPA and not LANES.begins(world):
        return LANES.withdraw(world, x > END_M - 0.01), 0.0
    if touching(world):
        return _push(world, habits, pressure)
    if pressure > SEARCH_KPA or x > END_M:
        return np.zeros(3), 0.0
    return LANES.ahead(world, habits, 0.08), habits.low_kpa


def _push(world: World, habits: Habits, pressure: float) -> Wish:
    """Inflate and creep ahead with the imprint in the middle of the gel."""
    full = np.clip((pressure - habits.low_kpa) / (habits.high_kpa - habits.low_kpa), 0, 1)
    at = world.imprint_m
    across, along = (0.0, 0.0) if at is None else at
    ahead = 0.03 - 0.012 * full
    aside = np.array([CENTRE_ACROSS_HZ * across, CENTRE_ALONG_HZ * along])
    return habits.speed * np.array([ahead, *-aside]), habits.high_kpa
