"""Carries points along with the particles of a body: vertices of meshes, samples of rays."""

import numpy as np
from scipy.spatial import cKDTree

NEAR = 12  # particles that a point follows


def carry(
    points: np.ndarray, rest: np.ndarray, positions: np.ndarray, gradients: np.ndarray, near: int = NEAR
) -> np.ndarray:
    """Moves points by the deformation of the particles next to them.

    Each particle maps its surroundings by x = x_p + F_p (X - X_p); a point takes the mean of its nearest
    ones, weighted by (1 - (d / R)^2)^2 over the distance d, where R lies beyond the last of them. Affine
    deformations are met exactly, also a little outside the body.

    Args:
        points: (K, 3) m, in the frame of `rest`.
        rest: (P, 3) particles before, m.
        positions: (..., P, 3) particles after, m.
        gradients: (..., P, 3, 3) deformation gradients from before to after.
        near: particles that a point follows.

    Returns:
        (..., K, 3) m.
    """
    d, index = cKDTree(rest).query(points, k=near)
    w = (1 - (d / (1.05 * d[:, -1:] + 1e-12)) ** 2) ** 2
    w /= w.sum(1, keepdims=True)
    offset = points[:, None] - rest[index]  # (K, near, 3)
    near_positions, near_gradients = positions[..., index, :], gradients[..., index, :, :]
    mapped = near_positions + np.einsum("...knij,knj->...kni", near_gradients, offset)
    return np.einsum("kn,...kni->...ki", w, mapped)
