"""Flip the switch: search lane by lane, press on where it touches, let go when it has snapped over."""

import numpy as np

from pneutac_sim.world.experts.motion import Habits, Script, advance, go, hold, imprint_m, touching
from pneutac_sim.world.world import DT, World

# Where to look for the bar, across: nearer to each other than gel and bar together are wide, so that the bar
# is never between two lanes.
LANES_M = (-0.0115, 0.0, 0.0115)
LEVEL_M = 0.118  # height of the bar
END_M = 0.533  # the gel is behind the farthest bar
BACK_M = (-0.05, 0.0, 0.02)  # retreat
SNAP = 0.6  # the lever has snapped over when this part of the largest imprint is left


def flip_switch(world: World, habits: Habits) -> Script:
    """Try the lanes until one touches, inflate while pushing, retreat inflated when the touch is gone."""
    task = world.task
    while task.lever_rad < 0.5 * task.well_rad:
        for y in LANES_M:
            yield from _shift(world, habits, y)
            lane = np.array([0.0, y, LEVEL_M])
            yield from advance(world, habits, lane, 0.08, lambda: touching(world) or world.gel_m[0] > END_M)
            if touching(world):
                yield from hold(habits.pause_s, habits.low_kpa)
                yield from _push(world, habits)
                yield from go(world, world.flange_m + BACK_M, 0.08 * habits.speed, habits.high_kpa)
                break
            while world.flange_m[0] > task.home_m[0] + 0.03:
                yield np.array([-0.095, 0.0, 0.0]), habits.low_kpa
    while not world.success:
        yield np.zeros(3), habits.high_kpa


def _shift(world: World, habits: Habits, lane_y: float) -> Script:
    """Sideways to the start of a lane."""
    while abs(away := lane_y - world.flange_m[1]) > 0.005:
        yield np.array([0.0, np.sign(away) * 0.08, 0.0]) * habits.speed, habits.low_kpa


def _push(world: World, habits: Habits) -> Script:
    """Inflate, creep ahead with the imprint in the middle of the gel, until the force drops."""
    lost, peak = 0, 0.0
    while lost < 2:
        lost = 0 if touching(world) else lost + 1
        full = np.clip((world.pressure_kpa - habits.low_kpa) / (habits.high_kpa - habits.low_kpa), 0, 1)
        peak = max(peak, world.press_mm)
        if full > 0.9 and world.press_mm < SNAP * peak:
            break
        at = imprint_m(world)
        across, along = (0.0, 0.0) if at is None else at
        ahead = 0.02 - 0.008 * full
        yield habits.speed * np.array([ahead, -3.0 * across, -3.0 * along]), habits.high_kpa
    for _ in range(round(habits.overshoot_s / DT)):
        yield habits.speed * np.array([0.012, 0.0, 0.0]), habits.high_kpa
