"""Carries points along with the particles of a body: vertices of meshes, samples of rays."""

import numpy as np
from scipy.spatial import cKDTree

NEAR = 12  # particles that a point follows


class Carrier:
    """Points that follow a body.

    Each particle maps its surroundings by x = x_p + F_p (X - X_p); a point takes the mean of its nearest
    ones, weighted by (1 - (d / R)^2)^2 over the distance d, where R lies beyond the last of them. Affine
    deformations are met exactly, also a little outside the body.

    Args:
        points: (K, 3) m, in the frame of `rest`.
        rest: (P, 3) particles before, m.
    """

    def __init__(self, points: np.ndarray, rest: np.ndarray):
        d, self._index = cKDTree(rest).query(points, k=NEAR)
        w = (1 - (d / (1.05 * d[:, -1:] + 1e-12)) ** 2) ** 2
        self._weights = w / w.sum(1, keepdims=True)
        self._offset = points[:, None] - rest[self._index]  # (K, NEAR, 3)

    def __call__(self, positions: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """(..., K, 3) m where the points are.

        Args:
            positions: (..., P, 3) particles after, m.
            gradients: (..., P, 3, 3) deformation gradients from before to after.
        """
        there, turned = positions[..., self._index, :], gradients[..., self._index, :, :]
        mapped = there + np.einsum("...knij,knj->...kni", turned, self._offset)
        return np.einsum("kn,...kni->...ki", self._weights, mapped)


def carry(points: np.ndarray, rest: np.ndarray, positions: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """One use of `Carrier`: points (..., K, 3), m."""
    return Carrier(points, rest)(positions, gradients)
