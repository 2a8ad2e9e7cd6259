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

import math

import mujoco
import numpy as np
from numba import njit

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
        w, *v = data.qpos[self._angles].reshape(-1, 4).T
        sine = np.linalg.norm(v, axis=0)
        turn = 2 * np.arctan2(sine, w) / np.maximum(sine, 1e-12)  # |rotation vector| / |v|; 2 where straight
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
    q = np.empty(4)
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
        ways = np.diff(places, axis=0, append=places[-1:])
        self._balls = (mass, middle - places, whole, ways) if model.jnt_type[hinges[0]] == BALL else None

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
        if self._balls is not None:
            turned = np.empty((steps, len(before), 3))
            ball_torques(
                *self._balls, before, rate, slope, K.diagonal().copy(), D.diagonal().copy(), self._h, turned
            )
            return turned.reshape(steps, -1), slope
        out = np.empty((steps, len(before)))
        _torques(self._A, self._inertia, before, rate, slope, K, D, self._h, out)
        return out, slope


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


@njit(cache=True)
def ball_torques(mass, centre, inertia, ways, before, rate, slope, K, D, h, out):
    """As `_torques` where the joints are balls, into `out` (S, N, 3), N m: inverse dynamics of their chain.

    Newton and Euler link by link (Featherstone, Rigid Body Dynamics Algorithms, ch. 5), in the frame of the
    base. Rates of a ball are those of its link, in the link's own frame, as MuJoCo has them.

    (M + h D) (v_k - v_{k-1}) = h (tau - K w_{k-1} - D v_{k-1} - c), as `implicitfast` has it, where v_k turns
    the joint from rotation vector w_{k-1} to w_k.

    Links have masses (N,) kg, centres of mass (N, 3) m from their joints, inertias (N, 3, 3) kg m2 about
    these in their own frames, and ways (N, 3) m from each joint to the next. The path has angles `before` (N,
    2) towards +z and +y, a rate there and a mean slope over the steps; K and D are (N,) N m/rad and N m
    s/rad.
    """
    steps, n, _ = out.shape
    w, new = before.copy(), np.empty((n, 2))
    R, turned, link = np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3))
    v, v_new = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        _rotation(before[i, 0] - h * rate[i, 0], before[i, 1] - h * rate[i, 1], turned[i])
        _rotation(w[i, 0], w[i, 1], R[i])
        _rate(turned[i], R[i], h, v[i])
    force, moment, way = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    a, own, faster_own, arm = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    spin, faster, at = np.empty(3), np.empty(3), np.empty(3)
    for k in range(steps):
        s = (k + 1) / steps
        for i in range(n):
            for c in range(2):  # as `_torques`
                bow = 3.0 * steps / (steps + 1.0) * (slope[i, c] - rate[i, c])
                new[i, c] = rate[i, c] + (slope[i, c] - rate[i, c]) * s + bow * s * (1.0 - s)
            _rotation(w[i, 0] + h * new[i, 0], w[i, 1] + h * new[i, 1], turned[i])
            _rate(R[i], turned[i], h, v_new[i])
        spin[:], faster[:], at[:] = 0.0, 0.0, 0.0  # of the link before, and the acceleration of its end
        for i in range(n):
            for r in range(3):
                for c in range(3):
                    link[i, r, c] = R[i, r, c]
                    if i > 0:
                        link[i, r, c] = 0.0
                        for j in range(3):
                            link[i, r, c] += link[i - 1, r, j] * R[i, j, c]
            _turn(link[i], v[i], own)
            for r in range(3):
                a[r] = (v_new[i, r] - v[i, r]) / h
            _turn(link[i], a, faster_own)
            _add_cross(spin, own, faster_own)
            for r in range(3):
                faster[r] += faster_own[r]
                spin[r] += own[r]
            _turn(link[i], centre[i], arm)
            _turn(link[i], ways[i], way[i])
            a[:] = at
            _add_swing(faster, spin, arm, a)
            for r in range(3):
                force[i, r] = mass[i] * a[r]
            _euler(link[i], inertia[i], faster, spin, moment[i])
            _add_cross(arm, force[i], moment[i])
            _add_swing(faster, spin, way[i], at)
        for i in range(n - 1, -1, -1):  # a joint turns its own link and all beyond it
            if i < n - 1:
                for r in range(3):
                    force[i, r] += force[i + 1, r]
                    moment[i, r] += moment[i + 1, r]
                _add_cross(way[i], force[i + 1], moment[i])
            for c in range(3):
                out[k, i, c] = D[i] * v_new[i, c]
                for r in range(3):
                    out[k, i, c] += link[i, r, c] * moment[i, r]
            out[k, i, 1] -= K[i] * w[i, 0]
            out[k, i, 2] += K[i] * w[i, 1]
            for c in range(2):
                w[i, c] += h * new[i, c]
            for r in range(3):
                v[i, r] = v_new[i, r]
                for c in range(3):
                    R[i, r, c] = turned[i, r, c]


@njit(cache=True)
def _turn(R, x, out):
    for r in range(3):
        out[r] = R[r, 0] * x[0] + R[r, 1] * x[1] + R[r, 2] * x[2]


@njit(cache=True)
def _add_cross(a, b, out):
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _add_swing(faster, spin, arm, out):
    """Adds the acceleration of an arm's end, faster x arm + spin x (spin x arm), to `out` (3,)."""
    _add_cross(faster, arm, out)
    along, square = 0.0, 0.0
    for r in range(3):
        along += spin[r] * arm[r]
        square += spin[r] * spin[r]
    for r in range(3):
        out[r] += spin[r] * along - arm[r] * square


@njit(cache=True)
def _euler(R, inertia, faster, spin, out):
    """J faster + spin x J spin into `out` (3,), with J = R inertia R^T."""
    for r in range(3):
        out[r] = 0.0
    turning = np.zeros(3)
    for r in range(3):
        for c in range(3):
            J = 0.0
            for i in range(3):
                for j in range(3):
                    J += R[r, i] * inertia[i, j] * R[c, j]
            out[r] += J * faster[c]
            turning[r] += J * spin[c]
    _add_cross(spin, turning, out)


@njit(cache=True)
def _rotation(to_z, to_y, R):
    """Rodrigues' formula for the rotation vector (0, -to_z, to_y), into R (3, 3)."""
    square = to_z * to_z + to_y * to_y
    angle = math.sqrt(square)
    a = math.sin(angle) / angle if angle > 1e-6 else 1.0
    b = (1.0 - math.cos(angle)) / square if angle > 1e-4 else 0.5
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - b * square, -a * to_y, -a * to_z
    R[1, 0], R[1, 1], R[1, 2] = a * to_y, 1.0 - b * to_y * to_y, -b * to_y * to_z
    R[2, 0], R[2, 1], R[2, 2] = a * to_z, -b * to_y * to_z, 1.0 - b * to_z * to_z


@njit(cache=True)
def _rate(R, turned, h, v):
    """Into v (3,) the rate, in the link's frame, that turns R into `turned` in h s, by less than pi / 2."""
    for r in range(3):
        v[r] = 0.0
        i, j = (r + 1) % 3, (r + 2) % 3
        for c in range(3):  # of A = R^T turned the part A_ji - A_ij, 2 sin(angle) times the axis
            v[r] += R[c, j] * turned[c, i] - R[c, i] * turned[c, j]
    sine = 0.5 * math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    factor = math.asin(min(sine, 1.0)) / (2.0 * sine * h) if sine > 1e-9 else 0.5 / h
    for r in range(3):
        v[r] *= factor
