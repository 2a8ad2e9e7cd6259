"""Spine kinematics: from pressure to joint command, from joint angles to tip and bend.

Frame: x along the straight finger, z the bending direction at positive pressure, y completes the right hand.
Link 0 runs from the base to the first joint and is fixed; a positive angle bends towards +z. Lengths may be
in any one unit; the tip comes out in the same unit.
"""

import numpy as np

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
    return np.stack([x, z], axis=-1), heading[..., -1]


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
    links = _links(joint_positions, length)
    tip = np.zeros((*q.shape[:-2], 3))
    tip[..., 0] = joint_positions[0]
    frame = np.broadcast_to(np.eye(3), (*q.shape[:-2], 3, 3))
    for n, link in enumerate(links):
        frame = frame @ bend_rotation(q[..., n, :])
        tip += link * frame[..., :, 0]
    return tip, q.sum(axis=-2)


def bend_rotation(q: np.ndarray) -> np.ndarray:
    """Rotation (..., 3, 3) that bends x by the angle |q| towards (0, q[1], q[0]) (Rodrigues' formula)."""
    to_z, to_y = q[..., 0], q[..., 1]
    angle = np.hypot(to_z, to_y)
    a = np.sinc(angle / np.pi)  # sin(angle) / angle
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2  # (1 - cos(angle)) / angle^2
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0] = np.cos(angle)
    R[..., 1, 0] = a * to_y
    R[..., 2, 0] = a * to_z
    R[..., 0, 1] = -a * to_y
    R[..., 0, 2] = -a * to_z
    R[..., 1, 1] = 1 - b * to_y * to_y
    R[..., 2, 2] = 1 - b * to_z * to_z
    R[..., 1, 2] = R[..., 2, 1] = -b * to_y * to_z
    return R


def _links(joint_positions: np.ndarray, length: float) -> np.ndarray:
    """(N,) length of the link after each joint; raises InputError where joints are not in order."""
    links = np.diff(np.append(np.asarray(joint_positions, dtype=float), length))
    if not ((links > 0).all() and joint_positions[0] >= 0):
        raise InputError(
            f"Joint positions {list(joint_positions)} with length {length}: they must rise from base to tip."
        )
    return links
