"""Open the carton: touch its front wall, slide up until the lid's tab is felt, lift along the lid's arc."""

import numpy as np

from pneutac_sim.world.experts.motion import Habits, Script, advance, go, hold, imprint_m, touching
from pneutac_sim.world.world import World

LANES_M = (-0.0135, 0.0, 0.0135)  # where to look for the tab, across; less apart than gel and tab are wide
BELOW_M = 0.015  # how far below the lid's edge to touch the wall
WALL_M = 0.006  # imprints nearer to the gel's end are of the wall
TOP_M = 0.145  # flange above the lid's edge when the finger is past it


def open_carton(world: World, habits: Habits) -> Script:
    """Touch the wall, slide up; where no tab is felt try the next lane, else inflate under it and lift."""
    task, k = world.task, 0
    while not world.success:
        lane = np.array([0.0, LANES_M[k % len(LANES_M)], task.edge_m - BELOW_M])
        yield from advance(world, habits, lane, 0.06, lambda: touching(world))
        yield from hold(habits.pause_s, habits.low_kpa)
        while not _hooked(world) and world.flange_m[2] < task.edge_m + TOP_M:
            ahead = np.clip(0.15 * (0.25 - world.press_mm), -0.01, 0.02)
            yield habits.speed * np.array([ahead, 0.0, 0.055]), habits.low_kpa
        if _hooked(world):
            yield from _lift(world, habits)
            if world.success:
                return
        k += 1
        top = world.flange_m
        while world.flange_m[0] > top[0] - 0.03:  # straight out, not into the tab's side
            yield np.array([-0.095, 0.0, 0.0]), habits.low_kpa
        start = world.flange_m + (-0.01, 0.0, 0.0)
        start[1:] = LANES_M[k % len(LANES_M)], task.edge_m + 0.115
        yield from go(world, start, 0.095, habits.low_kpa)


def _hooked(world: World) -> bool:
    """Whether an edge lies on the gel, not only the wall on its end."""
    at = imprint_m(world)
    return at is not None and at[1] < WALL_M


def _lift(world: World, habits: Habits) -> Script:
    """Inflate, shift sideways until the tab lies on the middle of the gel, then lift."""
    felt, lost = world.flange_m, 0
    while world.pressure_kpa < habits.high_kpa - 0.5 or (
        abs(_across(world)) > 0.004 and abs(world.flange_m[1] - felt[1]) < 0.008
    ):
        yield np.array([0.0, -3.0 * _across(world), 0.0]), habits.high_kpa
    while not world.success and lost < 8:
        lost = 0 if touching(world, 0.05) else lost + 1
        rise = np.clip((world.flange_m[2] - felt[2]) / world.task.reach_m, 0, 0.95)
        ahead = np.array([rise, 0.0, np.sqrt(1 - rise**2)])
        yield habits.speed * (0.06 * ahead + (0.0, -2.0 * _across(world), 0.0)), habits.high_kpa


def _across(world: World) -> float:
    """How far beside the middle of the gel the tab lies, metres."""
    at = imprint_m(world)
    return 0.0 if at is None or at[1] > WALL_M else at[0]
