"""Franka Panda from its published kinematics: MJCF, closed-form forward kinematics, differential IK.

Kinematics: Craig's (modified) Denavit-Hartenberg parameters and joint limits as published by Franka Emika
in the robot's interface specification. Link shapes and masses are capsules of the arm's rough size: with
stiff joint control they matter for looks and little else.
"""

import math

import numpy as np
from numba import njit

from pneutac_sim.features import JOINT_HIGH, JOINT_LOW, JOINT_NAMES, JOINT_SPEED, PANDA_JOINTS
from pneutac_sim.least_squares import cholesky_solve

# Link offsets a (m), joint offsets d (m) and twists alpha (rad) of joints 1 to 7, then the flange (m).
DH_A = (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088)
DH_D = (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0)
DH_ALPHA = tuple(np.pi / 2 * k for k in (0, -1, 1, 1, -1, 1, 1))
FLANGE_M = 0.107
TASK = 6  # position and rotation
DAMPING, ITERATIONS = 0.01, 2  # of the inverse kinematics

# Flange straight down, elbow up; the start of every inverse kinematics.
HOME_JOINTS = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])

# Joint servo: stiffness (N m/rad) and reflected motor inertia (kg m2). Damping is SERVO_LAG_S x stiffness:
# near critical at home, and the same lag in every joint keeps the orientation held while the arm moves.
SERVO_STIFFNESS = (12000, 12000, 8000, 8000, 3000, 3000, 2000)
SERVO_LAG_S = 0.02
ARMATURE = 0.1

# Capsules of link i in its frame: (x, y, z of one end, x, y, z of the other, radius), metres; then kg.
_LINKS = (
    (((0, 0, -0.16, 0, 0, -0.03, 0.062), (0, -0.045, 0, 0, 0.045, 0, 0.06)), 3.0),
    (((0, 0, -0.03, 0, 0, 0.05, 0.058), (0, -0.04, 0, 0, -0.19, 0, 0.058)), 3.0),
    (((0, 0, -0.10, 0, 0, -0.03, 0.056), (0.0825, -0.03, 0, 0.0825, 0.03, 0, 0.052)), 2.5),
    (((0, 0, -0.03, 0, 0, 0.03, 0.052), (-0.0825, 0.05, 0, -0.0825, 0.14, 0, 0.052)), 2.5),
    (((0, 0, -0.22, 0, 0, -0.16, 0.05), (0, 0.06, -0.14, 0, 0.06, -0.02, 0.036)), 2.5),
    (((0, 0, -0.05, 0, 0, 0.03, 0.05), (0.088, 0, -0.02, 0.088, 0, 0.03, 0.046)), 1.5),
    (((0, 0, -0.01, 0, 0, 0.075, 0.042),), 0.7),
)


def forward_kinematics(q: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the flange in the arm's base frame, m, at joint angles (7,), by seven DH transforms."""
    T = np.eye(4)
    for a, alpha, d, theta in zip(DH_A, DH_ALPHA, DH_D, q, strict=True):
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
        T = T @ np.array(
            [[ct, -st, 0, a], [st * ca, ct * ca, -sa, -d * sa], [st * sa, ct * sa, ca, d * ca], [0, 0, 0, 1]]
        )
    T[:3, 3] += FLANGE_M * T[:3, 2]
    return T


def body(payload: str = "", base_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """MJCF body of the arm, its base at `base_m`; `payload` is MJCF placed in the frame `flange`."""
    site = '<site name="flange" size=".001" group="5"/>'
    xml = f'<body name="flange" pos="0 0 {FLANGE_M}">{site}{payload}</body>'
    for i in reversed(range(7)):
        capsules, mass = _LINKS[i]
        geoms = "".join(
            f'<geom class="arm" type="capsule" fromto="{" ".join(map(str, c[:6]))}" size="{c[6]}"'
            f' mass="{mass / len(capsules)}" material="{"arm_dark" if k else "arm"}"/>'
            for k, c in enumerate(capsules)
        )
        ca, sa = np.cos(DH_ALPHA[i]), np.sin(DH_ALPHA[i])
        pos = f"{DH_A[i]!r} {float(-sa * DH_D[i])!r} {float(ca * DH_D[i])!r}"
        quat = f"{float(np.cos(DH_ALPHA[i] / 2))!r} {float(np.sin(DH_ALPHA[i] / 2))!r} 0 0"
        xml = (
            f'<body name="link{i + 1}" pos="{pos}" quat="{quat}" gravcomp="1">'
            f'<joint name="{JOINT_NAMES[i]}" axis="0 0 1" range="{JOINT_LOW[i]} {JOINT_HIGH[i]}"'
            f' armature="{ARMATURE}"/>{geoms}{xml}</body>'
        )
    base = '<geom class="arm" type="capsule" fromto="-.06 0 .06 0 0 .08" size=".075" material="arm_dark"/>'
    return f'<body name="panda" pos="{" ".join(map(str, base_m))}">{base}{xml}</body>'


DEFAULTS = '<default class="arm"><geom contype="0" conaffinity="0" group="1"/></default>'
MATERIALS = (
    '<material name="arm" rgba=".93 .94 .95 1" specular=".4" shininess=".5"/>'
    '<material name="arm_dark" rgba=".32 .34 .38 1" specular=".3" shininess=".4"/>'
)


class CartesianIK:
    """Joint targets that bring the flange to a position with its orientation held as at home.

    Damped least squares: `dq = J^T (J J^T + damping^2 I)^-1 e`, with `e` the position error and the rotation
    vector to the held orientation. Joint limits are enforced by clipping.

    `arms.ChainIK` would do too. This one is compiled and takes a twentieth of its time, and it needs no
    order of position before orientation, as seven joints meet both in the whole workspace.

    Attributes:
        q: the present joint targets, as they were `reset`, rad; each `solve` starts from them.
    """

    missing_m = 0.0  # its whole workspace is in reach

    def __init__(self):
        alpha = np.array(DH_ALPHA)
        self._arm = np.array(DH_A), np.array(DH_D), np.cos(alpha), np.sin(alpha), FLANGE_M
        self._limits = np.array(JOINT_LOW, float), np.array(JOINT_HIGH, float)
        self._search = DAMPING**2, ITERATIONS
        self._held = np.ascontiguousarray(forward_kinematics(HOME_JOINTS)[:3, :3])
        self.reset(HOME_JOINTS)

    def reset(self, q: np.ndarray = HOME_JOINTS) -> None:
        """Starts again from the joint angles `q` (7,), or (M, 7) of M arms, rad; from home without."""
        self.q = np.array(q, float, order="C")

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and position (3,), m, of the flange in the base's frame at joint angles (7,)."""
        T = forward_kinematics(q)
        return T[:3, :3], T[:3, 3]

    def solve(self, position: np.ndarray) -> np.ndarray:
        """Joint targets (7,), rad, for the flange at `position` (3,), metres in the base frame.

        After `reset` with angles (M, 7) those (M, 7) of M arms at positions (M, 3).
        """
        at = np.array(position, float, ndmin=2)
        _solve(self.q.reshape(-1, PANDA_JOINTS), at, self._held, *self._arm, *self._limits, *self._search)
        return self.q.copy()


class Panda:
    """The paper's arm, with what the world asks of any; see `arms.Chain` for the attributes."""

    joints, root = PANDA_JOINTS, "panda"
    low_rad, high_rad, speed_rad_s, home_rad = JOINT_LOW, JOINT_HIGH, JOINT_SPEED, HOME_JOINTS

    def __init__(self, base_m: tuple[float, float, float] = (0.0, 0.0, 0.0)):
        """The arm, its base at `base_m` (3,)."""
        self.base_m = np.array(base_m, float)

    def body(self, payload: str = "") -> str:
        """MJCF body of the arm; `payload` is MJCF placed in the frame `flange`."""
        return body(payload, tuple(self.base_m.tolist()))

    def servos(self) -> str:
        """MJCF position servos of the seven joints."""
        return "".join(
            f'<position name="servo_{j}" joint="{j}" kp="{kp}" kv="{SERVO_LAG_S * kp}"/>'
            for j, kp in zip(JOINT_NAMES, SERVO_STIFFNESS, strict=True)
        )

    def solver(self) -> CartesianIK:
        """Inverse kinematics of the flange in the base's frame."""
        return CartesianIK()


@njit(cache=True)
def _solve(q, position, rotation, a, d, ca, sa, flange_m, low, high, damping2, iterations):
    """Moves joint angles `q` (M, 7) by damped least squares, `dq = J^T (J J^T + damping2 I)^-1 e`.

    The flange, `flange_m` along z of the last frame, goes to positions (M, 3) m with a rotation (3, 3). Links
    have offsets a and d (7,) m and cosines and sines (7,) of their twists, joints the limits low and high
    (7,) rad.
    """
    for k in range(len(q)):
        _approach(q[k], position[k], rotation, a, d, ca, sa, flange_m, low, high, damping2, iterations)


@njit(cache=True)
def _approach(q, position, rotation, a, d, ca, sa, flange_m, low, high, damping2, iterations):
    """`_solve` of one arm: `q` (7,) and position (3,)."""
    n = len(q)
    J, A, y = np.empty((TASK, n)), np.empty((TASK, TASK)), np.empty(TASK)
    R, p = np.empty((3, 3)), np.empty(3)
    axes, origins = np.empty((n, 3)), np.empty((n, 3))
    for _ in range(iterations):
        R[:] = 0.0
        R[0, 0] = R[1, 1] = R[2, 2] = 1.0
        p[:] = 0.0
        for i in range(n):
            ct, st = math.cos(q[i]), math.sin(q[i])
            for r in range(3):
                x, s, z = R[r]
                p[r] += a[i] * x - sa[i] * d[i] * s + ca[i] * d[i] * z
                R[r, 0] = ct * x + st * (ca[i] * s + sa[i] * z)
                R[r, 1] = -st * x + ct * (ca[i] * s + sa[i] * z)
                R[r, 2] = ca[i] * z - sa[i] * s
                axes[i, r], origins[i, r] = R[r, 2], p[r]
        for r in range(3):
            p[r] += flange_m * R[r, 2]
        for i in range(n):
            z, o = axes[i], origins[i]
            u, v, w = p[0] - o[0], p[1] - o[1], p[2] - o[2]
            J[0, i], J[1, i], J[2, i] = z[1] * w - z[2] * v, z[2] * u - z[0] * w, z[0] * v - z[1] * u
            J[3, i], J[4, i], J[5, i] = z
        _error(position, rotation, p, R, y)
        for r in range(TASK):
            for c in range(r + 1):
                A[r, c] = damping2 if r == c else 0.0
                for i in range(n):
                    A[r, c] += J[r, i] * J[c, i]
        cholesky_solve(A, y)
        for i in range(n):
            step = 0.0
            for r in range(TASK):
                step += J[r, i] * y[r]
            q[i] = min(max(q[i] + step, low[i]), high[i])


@njit(cache=True)
def _error(position, rotation, p, R, e):
    """Into `e` (6,): what is missing in position, and the rotation vector of `rotation` R^T."""
    trace = 0.0
    E = np.zeros((3, 3))
    for r in range(3):
        e[r] = position[r] - p[r]
        for c in range(3):
            for k in range(3):
                E[r, c] += rotation[r, k] * R[c, k]
        trace += E[r, r]
    x, y, z = 0.5 * (E[2, 1] - E[1, 2]), 0.5 * (E[0, 2] - E[2, 0]), 0.5 * (E[1, 0] - E[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    scale = math.atan2(sine, 0.5 * (trace - 1.0)) / sine if sine > 1e-12 else 1.0
    e[3], e[4], e[5] = scale * x, scale * y, scale * z
