"""Rigid motions of what was measured: turn and shift of points, shift of anything else."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

LEAST_TURN = 0.003  # of the points' own weight: what speaks for no turn


@dataclass(frozen=True)
class Motion:
    """A rigid motion, `points @ turn.T + shift`.

    Attributes:
        turn: (k, k), the identity for what is no point of space.
        shift: (k,).
    """

    turn: np.ndarray
    shift: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Moves (n, k)."""
        return points @ self.turn.T + self.shift

    @property
    def angle_deg(self) -> float:
        k = len(self.shift)
        cosine = (np.trace(self.turn) - k + 2) / 2
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))

    def then(self, step: np.ndarray) -> "Motion":
        """Moved on by a shift and a small turn, see `small`."""
        k = len(self.shift)
        turn = np.eye(k)
        if len(step) > k:
            turn = Rotation.from_rotvec(step[k:]).as_matrix() if k == 3 else _plane(step[k])
        return Motion(turn @ self.turn, turn @ self.shift + step[:k])

    @staticmethod
    def small(points: np.ndarray, rows: np.ndarray, turns: bool) -> np.ndarray:
        """What a unit of shift along each axis, and of turn, adds to some of the points (n, k), (n, k, m)."""
        k = points.shape[1]
        moves = [np.tile(np.eye(k), (len(points), 1, 1))]
        if turns and k == 3:
            moves.append(np.stack([np.cross(axis, points) for axis in np.eye(3)], -1))
        elif turns:
            moves.append((points @ [[0.0, 1.0], [-1.0, 0.0]])[..., None])
        return np.concatenate(moves, -1) * rows[:, None, None]

    @classmethod
    def fit(cls, points: np.ndarray, goal: np.ndarray, turns: bool) -> "Motion":
        """Least squares from points (n, k) to their goals (n, k) (Kabsch 1976)."""
        a, b, turn = points.mean(0), goal.mean(0), np.eye(points.shape[1])
        if turns:
            both = (points - a).T @ (goal - b)
            # points near a plane leave a turn about it open: of equal turns the least
            u, _, vt = np.linalg.svd(both + LEAST_TURN * np.linalg.norm(both) * turn)
            mirror = np.ones(len(a))
            mirror[-1] = np.sign(np.linalg.det(vt.T @ u.T))
            turn = (vt.T * mirror) @ u.T
        return cls(turn, b - turn @ a)


def _plane(angle: float) -> np.ndarray:
    """Turn (2, 2) by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
