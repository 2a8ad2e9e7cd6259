"""Where effects of the tip put the finger: its base and its sensor are bodies that are moved.

Joints bend the finger, that of one chamber in its plane. What else the twin's effects do to the tip (stretch,
sideways bend, a mount that stands askew) moves two bodies of the model: the base by what happens to a marker
on the base itself, and the sensor with its gel, against the last link, by the rest. Links between follow
their joints.
"""

import mujoco
import numpy as np

from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.world.spine import end_of

BODIES = ("finger", "sensor")
STILL = 1e-5  # m, and of a quaternion's parts: by 10 mN the gel's force jumps then at most


class Placing:
    """The poses of base and sensor in the frames of their parents.

    Attributes:
        poses: (2, 7) position in m and quaternion of both, as last set.
        turned: (2,) rad by which effects turn the tip towards +z and +y.
    """

    def __init__(self, model: mujoco.MjModel):
        self._ids = [model.body(name).id for name in BODIES]
        self._rest = np.hstack([model.body_pos[self._ids], model.body_quat[self._ids]])
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, self._rest[0, 3:])
        self._mount = self._rest[0, :3].copy(), R.reshape(3, 3)  # where the base is thought to stand
        self.poses, self.turned = self._rest.copy(), np.zeros(2)

    def find(self, pipeline: PressurePipeline, joints: np.ndarray, dt_s: float) -> np.ndarray:
        """Poses (2, 7) at joint angles (N,) or (N, 2) in rad, one control step of `dt_s` on."""
        base, tip, bare = (
            pipeline.place_base(dt_s),
            pipeline.place(joints, dt_s),
            pipeline.place_without(joints),
        )
        R_base, R_tip, R_bare = (_frame(*m[3:]) for m in (base, tip, bare))
        if joints.ndim == 2:  # of balls: what the links add up to, beyond which the effects turn the tip
            end = end_of(joints)
            R_tip, R_bare = end @ R_bare.T @ R_tip, end
        # The base stands at base; in its frame the links end at bare, and the sensor has to be at tip.
        apart = R_bare.T @ (R_base.T @ (tip[:3] - base[:3]) - bare[:3])
        origin, R = self._mount
        self.turned = tip[3:] - bare[3:]
        positions = origin + R @ base[:3] * 1e-3, self._rest[1, :3] + apart * 1e-3
        turns = R @ R_base, R_bare.T @ R_base.T @ R_tip
        return np.stack([np.append(p, _quaternion(T)) for p, T in zip(positions, turns, strict=True)])

    def stays(self, poses: np.ndarray) -> bool:
        """Whether these poses (2, 7) are the present ones but for 10 um, as of a mount that is askew."""
        return bool(np.abs(poses - self.poses).max() < STILL)

    def between(self, poses: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """(S, 2, 7) on the way from the present poses to these, at shares (S, 1) of it."""
        sign = np.sign((self.poses[:, 3:] * poses[:, 3:]).sum(1, keepdims=True))  # a quaternion has two signs
        goal = np.hstack([poses[:, :3], sign * poses[:, 3:]])
        out = self.poses + shares[:, :, None] * (goal - self.poses)
        out[..., 3:] /= np.linalg.norm(out[..., 3:], axis=-1, keepdims=True)
        return out

    def set(self, model: mujoco.MjModel, poses: np.ndarray) -> None:
        """Moves both bodies to poses (2, 7)."""
        self.poses = poses
        model.body_pos[self._ids], model.body_quat[self._ids] = poses[:, :3], poses[:, 3:]

    def in_base(self, point_m: np.ndarray, flange_m: np.ndarray, flange: np.ndarray) -> np.ndarray:
        """A point (3,) of the world in mm in the frame where the base is thought to stand.

        Args:
            point_m: m.
            flange_m: position (3,) of the flange, m.
            flange: its rotation (3, 3).
        """
        origin, R = self._mount
        return 1e3 * R.T @ (flange.T @ (point_m - flange_m) - origin)


def _frame(to_z: float, to_y: float) -> np.ndarray:
    """Rotation (3, 3) of a link that is bent towards +z, then with its plane towards +y, rad."""
    c, s, k, m = np.cos(to_z), np.sin(to_z), np.cos(to_y), np.sin(to_y)
    return np.array([[k * c, -m, -k * s], [m * c, k, -m * s], [s, 0.0, c]])


def _quaternion(R: np.ndarray) -> np.ndarray:
    q = np.empty(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(R).ravel())
    return q
