"""A finger in a model: its joints, and where effects of its tip put its base and its sensor.

Joints are hinges where one chamber bends the finger in a plane, balls where several bend it.

A ball turns by the rotation vector (0, -to_z, to_y), as a joint of the pipeline's with two bending axes does.
A load may also turn it about the finger's own axis, on a spring like the others.
"""

import mujoco
import numpy as np

from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.twin import Twin

BALL = int(mujoco.mjtJoint.mjJNT_BALL)
BODIES = ("finger", "sensor")
STILL = 1e-5  # m, and of a quaternion's parts: by 10 mN the gel's force jumps then at most


def mjcf_joint(n: int, axes: int) -> str:
    """MJCF of the n-th joint, counted from 1, of so many bending axes."""
    kind = 'axis="0 -1 0"' if axes == 1 else 'type="ball"'
    return f'<joint name="spine_{n}" {kind}/>'


def mjcf_motors(n: int, axes: int, gear: float = 1.0) -> str:
    """MJCF of what drives it: their control times `gear` is the torque [N m], of a ball about x, y and z."""
    if axes == 1:
        return f'<motor name="spine_{n}" joint="spine_{n}" gear="{gear}"/>'
    gears = (f"{gear} 0 0", f"0 {gear} 0", f"0 0 {gear}")
    return "".join(
        f'<motor name="spine_{n}_{a}" joint="spine_{n}" gear="{g} 0 0 0"/>'
        for a, g in zip("xyz", gears, strict=True)
    )


class Spine:
    """The joints `spine_1` to `spine_N` of a finger in a model, with motors in their order.

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


class Placing:
    """The poses of base and sensor in the frames of their parents.

    What effects do to the tip beyond its bend (stretch, sideways bend, a mount that stands askew) moves these
    two bodies of the model: the base by what happens to a marker on the base itself, and the sensor with its
    gel, against the last link, by the rest. Links between follow their joints.

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
        offset = R_bare.T @ (R_base.T @ (tip[:3] - base[:3]) - bare[:3])
        origin, R = self._mount
        self.turned = tip[3:] - bare[3:]
        positions = origin + R @ base[:3] * 1e-3, self._rest[1, :3] + offset * 1e-3
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
        """A point (3,) of the world, m, in mm in the frame where the base is thought to stand.

        The flange's position (3,) is in m and its rotation (3, 3).
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
