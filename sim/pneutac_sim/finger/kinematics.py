"""Spine kinematics: from pressure to joint command, from joint angles to tip and bend.

Frame: x along the straight finger, z the bending direction at positive pressure, y completes the right hand.
Link 0 runs from the base to the first joint and is fixed; a positive angle bends towards +z. Lengths may be
in any one unit; the tip comes out in the same unit.
"""

import math

import numpy as np
from numba import njit

from pneutac_sim.errors import InputError


def gain_profile(n_joints: int, alpha: float, beta: float) -> np.ndarray:
    """How the bending is shared between the joints, r_n(alpha, beta) with unit mean (the paper's profile).

    r_n ∝ exp(alpha (n - nbar)) (1 + beta (n - nbar)^2), n = 1 at the base, nbar = (N + 1) / 2.

    Args:
        n_joints: N >= 1.
        alpha: skew towards the tip (positive) or the base (negative).
        beta: positive where the ends bend more than the middle; above -1 / ((N - 1) / 2)^2.

    Returns:
        (N,) profile, all positive, mean 1.

    Raises:
        InputError: the profile would not be positive everywhere.
    """
    m = np.arange(n_joints) - (n_joints - 1) / 2
    r = np.exp(alpha * m) * (1 + beta * m * m)
    if not (np.isfinite(r).all() and r.min() > 0):
        limit = f"above {-1 / m[-1] ** 2:.3g}" if n_joints > 1 else "finite"
        raise InputError(
            f"gain_beta is {beta} and gain_alpha {alpha}; with {n_joints} joints gain_beta must be {limit} "
            "and gain_alpha of moderate size, so that every joint bends in the same direction."
        )
    return r / r.mean()


def joint_command(
    pressure_kpa: np.ndarray | float, gain: float, alpha: float, beta: float, rest_pressure: float, n: int
) -> np.ndarray:
    """Target angle of each spine joint, q_n = G r_n(alpha, beta) (p + p0), in rad.

    Args:
        pressure_kpa: (...) gauge pressure.
        gain: G, rad/kPa.
        alpha: see `gain_profile`.
        beta: see `gain_profile`.
        rest_pressure: p0, kPa: the pressure that would make the bend already present at rest.
        n: number of joints N.

    Returns:
        (..., N) joint angles.
    """
    drive = gain * (np.asarray(pressure_kpa, dtype=float) + rest_pressure)
    return drive[..., None] * gain_profile(n, alpha, beta)


def forward_kinematics(
    q: np.ndarray, joint_positions: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tip of a finger that bends in the xz plane.

    Args:
        q: (..., N) joint angles, rad.
        joint_positions: (N,) arc length of each joint from the base.
        length: arc length of the tip.

    Returns:
        Tip (..., 2) as x, z in the unit of `length`; bend angle (...) of the tip, rad.
    """
    q = np.asarray(q, dtype=float)
    heading = q @ np.triu(np.ones((q.shape[-1], q.shape[-1])))  # cumulative sum, faster than np.cumsum here
    links = _links(joint_positions, length)
    x = joint_positions[0] + np.cos(heading) @ links
    z = np.sin(heading) @ links
    tip = np.empty((*x.shape, 2))
    tip[..., 0], tip[..., 1] = x, z
    return tip, heading[..., -1]


def forward_kinematics_spatial(
    q: np.ndarray, joint_positions: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tip of an arm whose joints bend towards z and y.

    Each joint turns the next link, in the frame of the link before it, by the angle |q_n| in the direction
    (0, q_n[1], q_n[0]) / |q_n|.

    Args:
        q: (..., N, 2) joint angles towards +z and towards +y, rad.
        joint_positions: (N,) arc length of each joint from the base.
        length: arc length of the tip.

    Returns:
        Tip (..., 3) as x, y, z in the unit of `length`; bend (..., 2) = sum of q_n, towards +z and +y, rad.
    """
    q = np.asarray(q, dtype=float)
    tip = np.empty((*q.shape[:-2], 3))
    links = _links(joint_positions, length)
    _chain(q.reshape(-1, len(links), 2), float(joint_positions[0]), links, tip.reshape(-1, 3))
    return tip, q.sum(axis=-2)


@njit(cache=True)
def _chain(q, first, links, tip):
    """Tips (n, 3) of chains of joints (n, N, 2), by Rodrigues' formula joint by joint."""
    x, y, z = np.empty(3), np.empty(3), np.empty(3)  # the frame's columns
    for t in range(len(q)):
        x[:], y[:], z[:] = 0.0, 0.0, 0.0
        x[0] = y[1] = z[2] = 1.0
        tip[t, 0], tip[t, 1], tip[t, 2] = first, 0.0, 0.0
        for n in range(len(links)):
            to_z, to_y = q[t, n, 0], q[t, n, 1]
            square = to_z * to_z + to_y * to_y
            angle = math.sqrt(square)
            a = math.sin(angle) / angle if angle > 1e-6 else 1.0
            b = (1.0 - math.cos(angle)) / square if angle > 1e-4 else 0.5
            for i in range(3):
                old_x, old_y, old_z = x[i], y[i], z[i]
                x[i] = (1.0 - b * square) * old_x + a * (to_y * old_y + to_z * old_z)
                lost = a * old_x + b * (to_y * old_y + to_z * old_z)
                y[i] = old_y - to_y * lost
                z[i] = old_z - to_z * lost
                tip[t, i] += links[n] * x[i]


def _links(joint_positions: np.ndarray, length: float) -> np.ndarray:
    """(N,) length of the link after each joint; raises InputError where joints are not in order."""
    links = np.diff(np.append(np.asarray(joint_positions, dtype=float), length))
    if not ((links > 0).all() and joint_positions[0] >= 0):
        raise InputError(
            f"Joint positions {list(joint_positions)} with length {length}: they must rise from base to tip."
        )
    return links
