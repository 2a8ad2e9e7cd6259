"""A wall in the tip's way: a compliant plane that may let go when pressed too hard."""

import numpy as np

from pneutac_truths.rod import BEND_Z, COLUMNS, SOFT, TIP_FORCE, Rod


def against_wall(rod: Rod, inputs: np.ndarray, bend_rad: float, wall: dict) -> np.ndarray:
    """Marker (n, 3) of a rod that meets a wall across the plain device's path.

    The wall pushes back in proportion to how deep the tip is in it. Where it can let go, the tip passes once
    that push would hold it back by more than `lets_go` of the way, and is free until it has come back.
    """
    at, ahead, compliance, way = place(rod, bend_rad, wall)
    k = wall["stiffness"] / compliance
    free = rod.solve(inputs)[0]
    depth = (free - at) @ ahead
    push = k * np.clip(depth, 0, None) / (1 + wall["stiffness"])
    pushed, held = inputs.copy(), free
    touching = depth > 0
    for _ in range(12):
        pushed[:, TIP_FORCE] = -push[:, None] * ahead
        held = rod.solve(pushed)[0]
        miss = np.where(touching, k * ((held - at) @ ahead) - push, 0.0)
        push = np.clip(push + miss / (1 + wall["stiffness"]), 0, None)
        if np.abs(miss).max() < 1e-4 * k * way:
            break
    past = _passed(depth, push * compliance > wall["lets_go"] * way)
    return np.where(past[:, None], free, held)


def place(rod: Rod, bend_rad: float, wall: dict) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Where a wall stands in the plain device's path.

    Returns:
        A point of it (3,) in mm, the way ahead (3,) into it, the tip's compliance along that way in mm^3
        (force over bending stiffness) and the length of the path in mm.
    """
    probe = np.zeros((3, COLUMNS))
    probe[:, SOFT] = 1
    probe[:, BEND_Z] = bend_rad * (1 - wall["taken"] + np.array([-0.01, 0, 0.01]))
    path = rod.solve(probe)[0]
    at, along = path[1], path[2] - path[0]
    ahead = along / np.linalg.norm(along)
    little = 1e-3 / rod.length_mm**2
    probe[1, TIP_FORCE] = little * ahead
    compliance = (rod.solve(probe[1:2])[0][0] - at) @ ahead / little
    return at, ahead, float(compliance), float(50 * np.linalg.norm(along))


def _passed(depth: np.ndarray, slips: np.ndarray) -> np.ndarray:
    """(n,) whether the tip has slipped past: from where it slips until it is back in front."""
    out = np.zeros(len(depth), bool)
    for i in range(len(depth)):
        out[i] = depth[i] > 0 and (slips[i] or (i > 0 and out[i - 1]))
    return out
