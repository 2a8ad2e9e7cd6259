"""A finger's joints in a model: hinges where one chamber bends it in a plane, balls where several bend it.

A ball turns by the rotation vector (0, -to_z, to_y), as a joint of the pipeline's with two bending axes does.
A load may also turn it about the finger's own axis, on a spring like the others.
"""

import mujoco
import numpy as np

from pneutac_sim.twin import Twin

BALL = int(mujoco.mjtJoint.mjJNT_BALL)


def mjcf_joint(n: int, axes: int) -> str:
    """MJCF of the n-th joint, counted from 1, of so many bending axes."""
    kind = 'axis="0 -1 0"' if axes == 1 else 'type="ball"'
    return f'<joint name="spine_{n}" {kind}/>'


def mjcf_motors(n: int, axes: int) -> str:
    """MJCF of what drives it: their control is the torque [N m], of a ball about x, y and z of its link."""
    if axes == 1:
        return f'<motor name="spine_{n}" joint="spine_{n}"/>'
    gears = ("1 0 0", "0 1 0", "0 0 1")
    return "".join(
        f'<motor name="spine_{n}_{a}" joint="spine_{n}" gear="{g} 0 0 0"/>'
        for a, g in zip("xyz", gears, strict=True)
    )


class Spine:
    """The joints `spine_1` to `spine_N` of a model.

    Args:
        model: of a scene with a finger, whose motors stand in the order of the degrees of freedom.
        twin: of the finger.

    Attributes:
        joints: N.
        balls: whether they are balls, with two bending axes.
        each: degrees of freedom of a joint.
        dofs: where they are in velocities, forces and controls.
    """

    def __init__(self, model: mujoco.MjModel, twin: Twin):
        self.joints, first = len(twin.spine_joint_positions_mm), model.joint("spine_1")
        self.balls = bool(first.type[0] == BALL)
        self.each = 3 if self.balls else 1
        at = int(first.dofadr[0])
        self.dofs = slice(at, at + self.each * self.joints)
        at = int(first.qposadr[0])
        self._angles = slice(at, at + (4 if self.balls else 1) * self.joints)

    def read(self, data: mujoco.MjData) -> np.ndarray:
        """Joint angles (N,), or of balls (N, 2) towards +z and +y, rad."""
        if not self.balls:
            return data.qpos[self._angles].copy()
        w, *v = data.qpos[self._angles].reshape(-1, 4).T
        sine = np.linalg.norm(v, axis=0)
        turn = (
            2 * np.arctan2(sine, w) / np.maximum(sine, 1e-12)
        )  # |rotation vector| / |v|; 2 where it is straight
        return np.stack([-turn * v[1], turn * v[2]], 1)

    def write(self, data: mujoco.MjData, q: np.ndarray) -> None:
        """Sets joint angles as of `read`."""
        data.qpos[self._angles] = quaternions(q).ravel() if self.balls else q


def quaternions(q: np.ndarray) -> np.ndarray:
    """(N, 4) of joint angles (N, 2) in rad."""
    angle = np.hypot(q[:, 0], q[:, 1])
    half = 0.5 * np.sinc(angle / (2 * np.pi))  # sin(angle / 2) / angle
    return np.stack([np.cos(angle / 2), np.zeros(len(q)), -half * q[:, 0], half * q[:, 1]], 1)


def end_of(q: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of the last link at joint angles (N, 2) in rad, in the frame of the base."""
    R, out = np.empty(9), np.eye(3)
    for quaternion in quaternions(q):
        mujoco.mju_quat2Mat(R, quaternion)
        out = out @ R.reshape(3, 3)
    return out
