"""Static equilibrium of the spine under loads: K (q - q_free) = torque of all forces about each joint.

Forces: one at the tip, and the weight of the body spread evenly over its length, acting at each link's
middle. Newton's method per sample, started from the deflection of the sample before; the derivative of the
torques follows from the same levers: turning joint k moves every force beyond it.
"""

import math

import numpy as np

from pneutac_sim.effects.body_effect import kernel

_ITERATIONS = 60  # heavy loads on soft joints; light ones take two or three
_TOLERANCE = 1e-6  # rad, of a step; what is left after it is a hundred times smaller


@kernel
def _solve(A, b, stiffness, L):
    """Solves (A + shift) x = b into b by Cholesky; the shift leads a buckling spine downhill.

    L's diagonal holds the inverse of the factor's, since divisions would cost most of the time.
    """
    n = len(b)
    shift = 0.0
    i = 0
    while i < n:
        for k in range(i):
            d = A[i, k]
            for m in range(k):
                d -= L[i, m] * L[k, m]
            L[i, k] = d * L[k, k]
        d = A[i, i] + shift
        for m in range(i):
            d -= L[i, m] * L[i, m]
        if d > 1e-3 * stiffness:
            L[i, i] = 1.0 / math.sqrt(d)
            i += 1
        elif shift <= 1e9 * stiffness:  # not positive definite: start again with a larger shift
            shift = max(2.0 * shift, stiffness)
            i = 0
        else:  # none helps a matrix that is not finite
            b[:] = np.nan
            return
    for i in range(n):
        for m in range(i):
            b[i] -= L[i, m] * b[m]
        b[i] *= L[i, i]
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, n):
            b[i] -= L[m, i] * b[m]
        b[i] *= L[i, i]


@kernel
def planar(q, loads, stiffness, links, state):
    """Turns free angles into loaded ones, in place.

    Args:
        q: (n, N) free angles in, loaded angles out, rad.
        loads: (n, 6) N: tip force x, y, z, then weight of the whole body x, y, z.
        stiffness: K of each joint, N m / rad.
        links: (N,) length of the link after each joint, m, then their share of the weight (N,).
        state: (N,) deflection of the sample before, updated.

    Angles or loads that are not finite make all angles from there on NaN.
    """
    n, joints = q.shape
    x, z = np.empty(joints + 1), np.empty(joints + 1)  # of joint i; the last is the tip
    torque, stretch = np.empty(joints), np.empty(joints)
    A, chol, b = np.empty((joints, joints)), np.empty((joints, joints)), np.empty(joints)
    for t in range(n):
        fx, fz, wx, wz = loads[t, 0], loads[t, 2], loads[t, 3], loads[t, 5]
        for _ in range(_ITERATIONS):
            heading = 0.0
            x[0], z[0] = 0.0, 0.0
            for i in range(joints):
                heading += q[t, i] + state[i]
                x[i + 1] = x[i] + links[i] * math.cos(heading)
                z[i + 1] = z[i] + links[i] * math.sin(heading)
            for i in range(joints):  # torque about joint i, and its derivative: sum of -(lever . force)
                torque[i] = (x[joints] - x[i]) * fz - (z[joints] - z[i]) * fx
                stretch[i] = (x[joints] - x[i]) * fx + (z[joints] - z[i]) * fz
                for m in range(i, joints):
                    share = links[joints + m]
                    rx, rz = 0.5 * (x[m] + x[m + 1]) - x[i], 0.5 * (z[m] + z[m + 1]) - z[i]
                    torque[i] += share * (rx * wz - rz * wx)
                    stretch[i] += share * (rx * wx + rz * wz)
            for i in range(joints):
                b[i] = torque[i] - stiffness * state[i]
                for k in range(joints):
                    A[i, k] = stretch[max(i, k)] + (stiffness if i == k else 0.0)
            _solve(A, b, stiffness, chol)
            if not math.isfinite(b[0]):
                q[t:] = np.nan
                return
            largest = 0.0
            for i in range(joints):
                step = min(max(b[i], -0.5), 0.5)  # keeps a near-singular step from throwing the spine about
                state[i] += step
                largest = max(largest, abs(step))
            if largest < _TOLERANCE:
                break
        for i in range(joints):
            q[t, i] += state[i]


@kernel
def _joint(to_z, to_y, R, axes):
    """Rotation of a joint with this bend, and its axes of to_z and to_y, in the frame of the link before."""
    angle2 = to_z * to_z + to_y * to_y
    angle = math.sqrt(angle2)
    if angle < 1e-4:
        a, b, g = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
        g = (1.0 - a) / angle2
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - b * angle2, -a * to_y, -a * to_z
    R[1, 0], R[1, 1], R[1, 2] = a * to_y, 1.0 - b * to_y * to_y, -b * to_y * to_z
    R[2, 0], R[2, 1], R[2, 2] = a * to_z, -b * to_y * to_z, 1.0 - b * to_z * to_z
    # Left Jacobian I + b [w] + g [w]^2 of the rotation vector w = (0, -to_z, to_y), applied to dw (Barfoot,
    # State Estimation for Robotics, Sec. 7.1).
    wy, wz = -to_z, to_y
    for i in range(2):
        ey, ez = (-1.0, 0.0) if i == 0 else (0.0, 1.0)
        dot = wy * ey + wz * ez
        axes[i, 0] = b * (wy * ez - wz * ey)
        axes[i, 1] = ey + g * (wy * dot - ey * angle2)
        axes[i, 2] = ez + g * (wz * dot - ez * angle2)


@kernel
def _places(free, deflection, links, at, axes):
    """Writes where joints and tip are (joints + 1, 3), m, and the joints' axes (2 joints, 3), base frame."""
    frame, turned, R, local = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3))
    for r in range(3):
        for c in range(3):
            frame[r, c] = 1.0 if r == c else 0.0
    for i in range(len(at) - 1):
        _joint(free[2 * i] + deflection[2 * i], free[2 * i + 1] + deflection[2 * i + 1], R, local)
        for r in range(3):
            f0, f1, f2 = frame[r, 0], frame[r, 1], frame[r, 2]
            for k in range(2):
                axes[2 * i + k, r] = f0 * local[k, 0] + f1 * local[k, 1] + f2 * local[k, 2]
            for c in range(3):
                turned[r, c] = f0 * R[0, c] + f1 * R[1, c] + f2 * R[2, c]
            at[i + 1, r] = at[i, r] + links[i] * turned[r, 0]
        frame, turned = turned, frame


@kernel
def tip_levers(q, links, out):
    """Writes how the tip moves with each joint of a free spine.

    Args:
        q: (n, 2 N) joint angles, rad.
        links: (N,) length of the link after each joint.
        out: (n, 3 or more, 2 N): rows 0 to 2 become tip x, y, z per rad.
    """
    n, size = q.shape
    joints = size // 2
    at, axes, still = np.zeros((joints + 1, 3)), np.empty((size, 3)), np.zeros(size)
    for t in range(n):
        _places(q[t], still, links, at, axes)
        for j in range(size):
            i = j // 2
            x, y, z = at[joints, 0] - at[i, 0], at[joints, 1] - at[i, 1], at[joints, 2] - at[i, 2]
            out[t, 0, j] = axes[j, 1] * z - axes[j, 2] * y
            out[t, 1, j] = axes[j, 2] * x - axes[j, 0] * z
            out[t, 2, j] = axes[j, 0] * y - axes[j, 1] * x


@kernel
def spatial(q, loads, stiffness, links, state):
    """As `planar`, for two bending axes: q and state hold (to z, to y) of joint 1, then of joint 2, ...

    With D = sum of lever (x) force over the forces beyond a joint, turning it about the axis a changes their
    moment by D a - tr(D) a, and the moment itself is the antisymmetric part of D.
    """
    n, size = q.shape
    joints = size // 2
    at = np.zeros((joints + 1, 3))
    axes = np.empty((size, 3))
    D, change = np.empty((3, 3)), np.empty(3)
    point, force = np.empty((3, 3)), np.empty(3)  # sums of position (x) force, and of force
    A, chol, b = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    for t in range(n):
        for _ in range(_ITERATIONS):
            _places(q[t], state, links, at, axes)
            for r in range(3):
                force[r] = loads[t, r]
                for c in range(3):
                    point[r, c] = at[joints, r] * loads[t, c]
            for i in range(joints - 1, -1, -1):
                share = links[joints + i]
                for r in range(3):
                    force[r] += share * loads[t, 3 + r]
                    for c in range(3):
                        point[r, c] += 0.5 * (at[i, r] + at[i + 1, r]) * share * loads[t, 3 + c]
                for r in range(3):
                    for c in range(3):
                        D[r, c] = point[r, c] - at[i, r] * force[c]
                trace = D[0, 0] + D[1, 1] + D[2, 2]
                mx, my, mz = D[1, 2] - D[2, 1], D[2, 0] - D[0, 2], D[0, 1] - D[1, 0]
                for j in range(2 * i, 2 * i + 2):
                    ax, ay, az = axes[j, 0], axes[j, 1], axes[j, 2]
                    b[j] = ax * mx + ay * my + az * mz - stiffness * state[j]
                    for r in range(3):
                        change[r] = D[r, 0] * ax + D[r, 1] * ay + D[r, 2] * az - trace * axes[j, r]
                    for k in range(2 * i + 2):
                        A[j, k] = -(axes[k, 0] * change[0] + axes[k, 1] * change[1] + axes[k, 2] * change[2])
                    A[j, j] += stiffness
                # The two bends of one joint have no order: the mean of either order.
                A[2 * i + 1, 2 * i] = 0.5 * (A[2 * i + 1, 2 * i] + A[2 * i, 2 * i + 1])
            _solve(A, b, stiffness, chol)
            if not math.isfinite(b[0]):
                q[t:] = np.nan
                return
            largest = 0.0
            for j in range(size):
                step = min(max(b[j], -0.5), 0.5)
                state[j] += step
                largest = max(largest, abs(step))
            if largest < _TOLERANCE:
                break
        for j in range(size):
            q[t, j] += state[j]
