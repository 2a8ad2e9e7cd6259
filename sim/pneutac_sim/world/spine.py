"""A finger in a model: its joints, and where effects of its tip put its base and its sensor.

Joints are hinges where one chamber bends the finger in a plane, balls where several bend it.

A ball turns by the rotation vector (0, -to_z, to_y), as a joint of the pipeline's with two bending axes does.
A load may also turn it about the finger's own axis, on a spring like the others.

Torques with which the free finger goes where the pipeline says, at every substep.

A pipeline that was calibrated on a bench holds the finger's own inertia and damping in its lags. So that they
are not counted twice the world drives the spine with the inverse of its own free response,

    tau = M(q_d) q_d'' + c(q_d, q_d') + D q_d' + K q_d

along a path q_d through the pipeline's angles. What is left, M e'' + D e' + K e = load with e = q - q_d, is
how the finger gives way to contact and to the arm's motion: there its mass, damping and stiffness act.
"""

import functools
import operator

import mujoco
import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.surrogate.skeleton import coupling, dynamics
from pneutac_sim.twin import Twin

BALL = int(mujoco.mjtJoint.mjJNT_BALL)
BODIES = ("finger", "sensor")
STILL = 1e-5  # m, and of a quaternion's parts: by 10 mN the gel's force jumps then at most


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
        joints = Rotation.from_quat(data.qpos[self._angles].reshape(-1, 4), scalar_first=True)
        return joints.as_rotvec()[:, 1:] * (-1, 1)

    def write(self, data: mujoco.MjData, q: np.ndarray) -> None:
        """Sets joint angles as of `read`."""
        data.qpos[self._angles] = turned(q).as_quat(scalar_first=True).ravel() if self.balls else q


def turned(q: np.ndarray) -> Rotation:
    """N rotations of balls at joint angles (N, 2) in rad."""
    return Rotation.from_rotvec(np.stack([np.zeros(len(q)), -q[:, 0], q[:, 1]], 1))


def end_of(q: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of the last link at joint angles (N, 2) in rad, in the frame of the base."""
    return functools.reduce(operator.matmul, turned(q).as_matrix())


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
        R = Rotation.from_quat(self._rest[0, 3:], scalar_first=True).as_matrix()
        self._mount = self._rest[0, :3].copy(), R  # where the base is thought to stand
        self.poses, self.turned = self._rest.copy(), np.zeros(2)

    def find(self, pipeline: PressurePipeline, joints: np.ndarray, dt_s: float) -> np.ndarray:
        """Poses (2, 7) at joint angles (N,) or (N, 2) in rad, one control step of `dt_s` on."""
        base, tip = pipeline.place_base(dt_s), pipeline.place(joints, dt_s)
        bare = pipeline.place_without(joints)
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
    q = np.empty(4)  # SciPy's takes ten times as long
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(R).ravel())
    return q


class Follower:
    """The chain of a finger in a model, with all that its links carry.

    Its N hinges or balls are `spine_1` to `spine_N`, and it begins with the body `finger`.
    """

    def __init__(self, model: mujoco.MjModel, joints: int):
        self._h = float(model.opt.timestep)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        base = model.body("finger").id
        frame, origin = data.xmat[base].reshape(3, 3), data.xpos[base]
        link = {model.body(f"spine_{n + 1}").id: n for n in range(joints)}
        for b in range(base + 1, model.nbody):  # a body comes after its parent
            if b not in link and model.body_parentid[b] in link:
                link[b] = link[model.body_parentid[b]]
        mass, middle = np.zeros(joints), np.zeros((joints, 3))
        at = {b: frame.T @ (data.xipos[b] - origin) for b in link}
        for b, n in link.items():
            mass[n] += model.body_mass[b]
            middle[n] += model.body_mass[b] * at[b]
        middle /= mass[:, None]
        self._inertia, whole = np.zeros(joints), np.zeros((joints, 3, 3))  # about y, and all of it
        for b, n in link.items():
            axes = frame.T @ data.ximat[b].reshape(3, 3)
            r = x, _, z = at[b] - middle[n]
            self._inertia[n] += axes[1] ** 2 @ model.body_inertia[b] + model.body_mass[b] * (x * x + z * z)
            whole[n] += axes * model.body_inertia[b] @ axes.T
            whole[n] += model.body_mass[b] * (r @ r * np.eye(3) - np.outer(r, r))
        hinges = [model.joint(f"spine_{n + 1}").id for n in range(joints)]
        places = np.array([frame.T @ (data.xanchor[j] - origin) for j in hinges])
        self._A = coupling(mass, middle[:, 0] + 1j * middle[:, 2], places[:, 0])
        self._chain = None
        if model.jnt_type[hinges[0]] == BALL:
            self._chain = mujoco.MjData(_chain(mass, middle - places, whole, np.diff(places, axis=0)))

    def torques(
        self,
        before: np.ndarray,
        rate: np.ndarray,
        after: np.ndarray,
        K: np.ndarray,
        D: np.ndarray,
        steps: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torques (S, N) in N m, of balls (S, 3 N), of S substeps of a control step, and the rate after it.

        The path goes from angles `before` to `after`, (N,) or of balls (N, 2) in rad. Its rate, rad/s, goes
        without a jump from what it is to that of a straight line between them, by the parabola that ends
        there. K and D are stiffness and damping of the joints, (N, N) N m/rad and N m s/rad.
        """
        slope = (after - before) / (steps * self._h)
        if self._chain is not None:
            return self._of_balls(before, rate, slope, K.diagonal(), D.diagonal(), steps), slope
        out = np.empty((steps, len(before)))
        _torques(self._A, self._inertia, before, rate, slope, K, D, self._h, out)
        return out, slope

    def _of_balls(self, before, rate, slope, K, D, steps: int) -> np.ndarray:
        """As `_torques` where the joints are balls, (S, 3 N): inverse dynamics of their chain by MuJoCo.

        Rates of a ball are those of its link, in the link's own frame: of the rotation between two steps.
        """
        h, data, s = self._h, self._chain, (np.arange(1, steps + 1) / steps)[:, None, None]
        bow = 3.0 * steps / (steps + 1.0) * (slope - rate)  # as in `_torques`
        path = h * np.cumsum(rate + (slope - rate) * s + bow * s * (1.0 - s), axis=0)
        w = before + np.concatenate([[-h * rate], [0.0 * rate], path])  # from one step before the first
        at = turned(w.reshape(-1, 2)).as_quat(scalar_first=True).reshape(steps + 2, -1)
        v, out = np.empty((steps + 1, data.model.nv)), np.empty((steps, data.model.nv))
        for k in range(steps + 1):
            mujoco.mj_differentiatePos(data.model, v[k], h, at[k], at[k + 1])
        a, qpos, qvel, qacc = np.diff(v, axis=0) / h, data.qpos, data.qvel, data.qacc
        for k in range(steps):
            qpos[:], qvel[:], qacc[:] = at[k + 1], v[k], a[k]
            mujoco.mj_inverse(data.model, data)
            out[k] = data.qfrc_inverse
        out += np.repeat(D, 3) * v[1:]
        out[:, 1::3] -= K * w[1:-1, :, 0]
        out[:, 2::3] += K * w[1:-1, :, 1]
        return out


def _chain(mass, centre, inertia, ways) -> mujoco.MjModel:
    """Links that hang on balls, without weight, each with its centre of mass (3,) from its ball, m.

    Inertias (N, 3, 3) kg m2 are about it, `ways` (N - 1, 3) m lead from one ball to the next.
    """
    xml = ""
    for n in reversed(range(len(mass))):
        place, (x, y, z), J = ways[n - 1] if n else np.zeros(3), centre[n], inertia[n]
        full = " ".join(map(repr, [*J.diagonal().tolist(), *map(float, (J[0, 1], J[0, 2], J[1, 2]))]))
        own = f'<inertial pos="{x} {y} {z}" mass="{mass[n]}" fullinertia="{full}"/>'
        xml = f'<body pos="{" ".join(map(str, place))}"><joint type="ball"/>{own}{xml}</body>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0"/><worldbody>{xml}</worldbody></mujoco>'
    )


@njit(cache=True)
def _torques(A, inertia, before, rate, slope, K, D, h, out):
    """Into `out` (S, N) what MuJoCo's step needs so that q_k = q_{k-1} + h q'_k goes along the path.

    (M + h D) (q'_k - q'_{k-1}) = h (tau - K q_{k-1} - D q'_{k-1} - c), as `implicitfast` has it.
    """
    steps, n = out.shape
    q, v, new = before.copy(), rate.copy(), np.empty(n)
    for k in range(steps):
        s = (k + 1) / steps
        M, c = dynamics(A, inertia, q, v)
        for i in range(n):
            # the sum of s (1 - s) is (S^2 - 1) / (6 S), so that all steps together go as far as the slope
            bow = 3.0 * steps / (steps + 1.0) * (slope[i] - rate[i])
            new[i] = rate[i] + (slope[i] - rate[i]) * s + bow * s * (1.0 - s)
        for i in range(n):
            out[k, i] = c[i]
            for j in range(n):
                out[k, i] += M[i, j] * (new[j] - v[j]) / h + K[i, j] * q[j] + D[i, j] * new[j]
        for i in range(n):  # not whole arrays: numba takes two seconds to compile the check of their shapes
            q[i] += h * new[i]
            v[i] = new[i]
