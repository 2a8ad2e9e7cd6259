"""Differential inverse kinematics of any chain of hinges: the position first, then the orientation."""

import mujoco
import numpy as np

DAMPING, TURN_DAMPING = 0.005, 0.05  # m and rad a joint's rad, below which a direction counts as out of reach
ITERATIONS = 3


class ChainIK:
    """Joint targets that bring the flange to a position, its orientation held as at home as far as it can.

    `dq = J_p+ e_p + (J_r N)+ (e_r - J_r J_p+ e_p)` with damped pseudo-inverses, the position's null space
    `N = I - J_p+ J_p`, position error e_p and rotation vector e_r to the held orientation (Siciliano and
    Slotine, ICAR 1991). Joint limits are kept by clipping.

    Attributes:
        q: the present joint targets (N,), rad; each `solve` starts from them.
        missing_m: by how much the last `solve` fell short.
    """

    def __init__(self, model: mujoco.MjModel, base_m: np.ndarray, home_rad: np.ndarray):
        """Of the arm alone in a model, with the site `flange`; its base at `base_m` (3,)."""
        self._model, self._data, self._base_m = model, mujoco.MjData(model), base_m
        self._site = model.site("flange").id
        self._home = home_rad
        self._held, _ = self.pose(home_rad)
        self.reset(home_rad)

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and position (3,), m, of the flange in the base's frame at joint angles (N,)."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.site_xmat[self._site].reshape(3, 3).copy()
        return rotation, self._data.site_xpos[self._site] - self._base_m

    def jacobian(self) -> tuple[np.ndarray, np.ndarray]:
        """Of position (3, N) and rotation (3, N), where `pose` was asked last."""
        position, rotation = np.zeros((2, 3, self._model.nv))
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jacSite(self._model, self._data, position, rotation, self._site)
        return position, rotation

    def reset(self, q: np.ndarray | None = None) -> None:
        """Starts again from the joint angles `q` (N,), rad; from home where there are none."""
        self.q, self.missing_m = np.array(self._home if q is None else q, float), 0.0

    def hold(self, q: np.ndarray) -> None:
        """Starts from the joint angles `q` (N,), rad, and holds the orientation that the flange has there."""
        self.reset(q)
        self._held, _ = self.pose(q)

    def solve(self, position: np.ndarray) -> np.ndarray:
        """Joint targets (N,), rad, for the flange at `position` (3,), metres in the base frame."""
        low, high = self._model.jnt_range.T
        for _ in range(ITERATIONS):
            rotation, at = self.pose(self.q)
            J_p, J_r = self.jacobian()
            away = np.zeros(4)
            mujoco.mju_mat2Quat(away, np.ascontiguousarray(self._held @ rotation.T).ravel())
            turn = np.zeros(3)
            mujoco.mju_quat2Vel(turn, away, 1.0)
            inverse = _inverse(J_p, DAMPING)
            step = inverse @ (position - at)
            free = J_r @ (np.eye(len(self.q)) - inverse @ J_p)
            step += _inverse(free, TURN_DAMPING) @ (turn - J_r @ step)
            self.q = np.clip(self.q + step, low, high)
        self.missing_m = float(np.linalg.norm(position - self.pose(self.q)[1]))
        return self.q.copy()


def _inverse(J: np.ndarray, damping: float) -> np.ndarray:
    """Damped pseudo-inverse `J^T (J J^T + damping^2 I)^-1`."""
    return J.T @ np.linalg.inv(J @ J.T + damping**2 * np.eye(len(J)))
