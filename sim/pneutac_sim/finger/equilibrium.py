"""Static equilibrium of the spine under loads: K (q - q_free) = torque of all forces about each joint.

Forces: one at the tip, and the weight of the body spread evenly over its length, acting at each link's
middle. Newton's method per sample, started from the deflection of the sample before; the derivative of the
torques follows from the same levers: turning joint k moves every force beyond it.

The soft body round a finger's spine: its torque on the joints, and how the spine yields to loads with it.

    K_c (q - q_free) = E (f(q) - f(q_free)) + tau(q)

The chamber drives the spine with a finite stiffness K_c, the same at every joint. The body's torque E f is
proportional to its modulus E, as in any elastic solid of one material, and f is measured on material points
(`pneutac_sim.mpm.devices`). It derives from an energy per modulus, a polynomial of the fourth order in the
joint angles: linear, and all products of two; of the third and fourth order those of one joint and its
neighbour, for a bend of one joint is felt no farther.
"""

import math
from collections import Counter
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from pneutac_sim.effects.body_effect import kernel
from pneutac_sim.errors import InputError

_ITERATIONS = 60  # heavy loads on soft joints; light ones take two or three
_NODES, _WORTH = 48, 0.5  # of a curve of deflections; its nodes by rows up to which it is less work
_TOLERANCE = 1e-5  # rad, of a step; what is left after it is of the order of its square


@kernel
def _substitute(L, b):
    """Solves L L^T x = b into b; the diagonal of L holds inverses."""
    n = len(b)
    for i in range(n):
        for m in range(i):
            b[i] -= L[i, m] * b[m]
        b[i] *= L[i, i]
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, n):
            b[i] -= L[m, i] * b[m]
        b[i] *= L[i, i]


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
    _substitute(L, b)


@kernel
def _planar(free, deflection, load, links, at, levers, A):
    """Places, levers and stiffness by geometry of one sample, bending in the xz plane.

    Args:
        free: (N,) angles without loads, rad.
        deflection: (N,) by loads.
        load: (6,) N: tip force x, y, z, then weight of the whole body x, y, z.
        links: (2 N,) length of the link after each joint, m, then their share of the weight.
        at: (N + 1, 3) m, becomes where joints and tip are.
        levers: (6, N) m, becomes what each joint moves the tip by, then the middle of the weight beyond it.
        A: (N, N) N m/rad, becomes minus the derivative of the torques by the angles, its lower triangle.
    """
    joints = len(free)
    heading = 0.0
    for i in range(joints):
        heading += free[i] + deflection[i]
        at[i + 1, 0] = at[i, 0] + links[i] * math.cos(heading)
        at[i + 1, 2] = at[i, 2] + links[i] * math.sin(heading)
    sx = sz = share = 0.0
    for i in range(joints - 1, -1, -1):
        part = links[joints + i]
        share += part
        sx += part * 0.5 * (at[i, 0] + at[i + 1, 0])
        sz += part * 0.5 * (at[i, 2] + at[i + 1, 2])
        levers[0, i], levers[2, i] = at[i, 2] - at[joints, 2], at[joints, 0] - at[i, 0]
        levers[3, i], levers[5, i] = share * at[i, 2] - sz, sx - share * at[i, 0]
        stretch = levers[2, i] * load[0] - levers[0, i] * load[2]
        stretch += levers[5, i] * load[3] - levers[3, i] * load[5]
        for k in range(i + 1):
            A[i, k] = stretch


@kernel
def _joint(to_z, to_y, R, axes, curve):
    """Rotation R (3, 3) of a joint that is bent by to_z and to_y, rad, in the frame of the link before.

    With the axes (2, 3) of both, and `curve` (3, 3), how these turn, (d axis_j / dq_k + d axis_k / dq_j) / 2
    for zz, zy and yy.
    """
    angle2 = to_z * to_z + to_y * to_y
    angle = math.sqrt(angle2)
    if angle < 1e-4:
        a, b, g = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
        g = (1.0 - a) / angle2
    if angle < 1e-2:
        db, dg = -1.0 / 24.0 + angle2 / 360.0, -1.0 / 120.0 + angle2 / 2520.0  # by the square of the angle
    else:
        db = 0.5 * (a - 2.0 * b) / angle2
        dg = (0.5 * (a - math.cos(angle)) / angle2 - g) / angle2
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
    for row in range(3):
        j, k = row // 2, (row + 1) // 2
        qj, qk = (to_y if j else to_z), (to_y if k else to_z)
        xj, xk = (-to_z if j else to_y), (-to_z if k else to_y)  # x of w (x) axis at no bend
        both = 2.0 * dg * qj * qk + (g if j == k else 0.0)
        own_j, own_k = -(dg * angle2 + 0.5 * g) * qk, -(dg * angle2 + 0.5 * g) * qj
        curve[row, 0] = db * (qk * xj + qj * xk)
        curve[row, 1] = -(both * to_z + (0.0 if j else own_j) + (0.0 if k else own_k))
        curve[row, 2] = both * to_y + (own_j if j else 0.0) + (own_k if k else 0.0)


@kernel
def _places(free, deflection, links, at, axes, curves):
    """Writes where joints and tip are (N + 1, 3), m, the joints' axes (2 N, 3) and how these turn (3 N, 3).

    Of angles and deflections (2 N,) rad and links (N,) m, in the base frame; see `_joint`.
    """
    frame, turned, R = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    local, curve = np.empty((2, 3)), np.empty((3, 3))
    for r in range(3):
        for c in range(3):
            frame[r, c] = 1.0 if r == c else 0.0
    for i in range(len(at) - 1):
        _joint(free[2 * i] + deflection[2 * i], free[2 * i + 1] + deflection[2 * i + 1], R, local, curve)
        for r in range(3):
            f0, f1, f2 = frame[r, 0], frame[r, 1], frame[r, 2]
            for k in range(2):
                axes[2 * i + k, r] = f0 * local[k, 0] + f1 * local[k, 1] + f2 * local[k, 2]
            for c in range(3):
                curves[3 * i + c, r] = f0 * curve[c, 0] + f1 * curve[c, 1] + f2 * curve[c, 2]
                turned[r, c] = f0 * R[0, c] + f1 * R[1, c] + f2 * R[2, c]
            at[i + 1, r] = at[i, r] + links[i] * turned[r, 0]
        frame, turned = turned, frame


@kernel
def _spatial(free, deflection, load, links, at, axes, curves, torque, A):
    """As `_planar`, for two bending axes: angles are (to z, to y) of joint 1, then of joint 2, ...

    torque (2 N,) N m becomes what the forces do about each axis, in place of the levers.
    With D = sum of lever (x) force over the forces beyond a joint, turning it about the axis a changes their
    moment by D a - tr(D) a.
    """
    joints = len(free) // 2
    _places(free, deflection, links, at, axes, curves)
    middle, D, change = np.zeros(3), np.empty((3, 3)), np.empty(3)
    share = 0.0
    for i in range(joints - 1, -1, -1):
        part = links[joints + i]
        share += part
        for r in range(3):
            middle[r] += part * 0.5 * (at[i, r] + at[i + 1, r])
        for r in range(3):
            tip, weight = at[joints, r] - at[i, r], middle[r] - share * at[i, r]
            for c in range(3):
                D[r, c] = tip * load[c] + weight * load[3 + c]
        trace = D[0, 0] + D[1, 1] + D[2, 2]
        for j in range(2 * i, 2 * i + 2):
            for r in range(3):
                change[r] = -trace * axes[j, r]
                for c in range(3):
                    change[r] += D[r, c] * axes[j, c]
            for k in range(2 * i + 2):
                A[j, k] = -(axes[k, 0] * change[0] + axes[k, 1] * change[1] + axes[k, 2] * change[2])
        # The two bends of one joint have no order: the mean of either order, and how the axes turn.
        A[2 * i + 1, 2 * i] = 0.5 * (A[2 * i + 1, 2 * i] + A[2 * i, 2 * i + 1])
        mx, my, mz = D[1, 2] - D[2, 1], D[2, 0] - D[0, 2], D[0, 1] - D[1, 0]
        for j in range(2 * i, 2 * i + 2):
            torque[j] = axes[j, 0] * mx + axes[j, 1] * my + axes[j, 2] * mz
        for row in range(3):
            c, j, k = 3 * i + row, 2 * i + (row + 1) // 2, 2 * i + row // 2
            A[j, k] -= curves[c, 0] * mx + curves[c, 1] * my + curves[c, 2] * mz


@kernel
def _spatial_levers(links, at, axes, levers):
    """Levers as `_planar` writes them, axis x lever, of what `_places` wrote."""
    joints = len(at) - 1
    middle, share = np.zeros(3), 0.0
    for i in range(joints - 1, -1, -1):
        part = links[joints + i]
        share += part
        for r in range(3):
            middle[r] += part * 0.5 * (at[i, r] + at[i + 1, r])
        for j in range(2 * i, 2 * i + 2):
            for o in range(3):
                p, q = (o + 1) % 3, (o + 2) % 3
                tip_p, tip_q = at[joints, p] - at[i, p], at[joints, q] - at[i, q]
                weight_p, weight_q = middle[p] - share * at[i, p], middle[q] - share * at[i, q]
                levers[o, j] = axes[j, p] * tip_q - axes[j, q] * tip_p
                levers[3 + o, j] = axes[j, p] * weight_q - axes[j, q] * weight_p


@kernel
def _resist(q, powers, weights, f, B):
    n = len(q)
    f[:], B[:] = 0.0, 0.0
    to_the = np.ones((n, powers.max() + 1))
    for p in range(1, to_the.shape[1]):
        to_the[:, p] = to_the[:, p - 1] * q
    for t in range(len(weights)):
        for i in range(n):
            p = powers[t, i]
            if p == 0:
                continue
            others = weights[t] * p
            for k in range(n):
                if k != i:
                    others *= to_the[k, powers[t, k]]
            f[i] -= others * to_the[i, p - 1]
            if p > 1:
                B[i, i] += others * (p - 1) * to_the[i, p - 2]
            for j in range(i):
                if powers[t, j] == 0:
                    continue
                value = weights[t] * p * to_the[i, p - 1] * powers[t, j] * to_the[j, powers[t, j] - 1]
                for k in range(n):
                    if k != i and k != j:  # noqa: PLR1714
                        value *= to_the[k, powers[t, k]]
                B[i, j] += value
                B[j, i] = B[i, j]


@kernel
def solve(q, loads, stiffness, links, state, powers=None, weights=None):
    """Turns free angles into loaded ones, in place.

    Args:
        q: (n, N) or, of two bending axes, (n, 2 N) free angles in, loaded angles out, rad.
        loads: (n, 6) N: tip force x, y, z, then weight of the whole body x, y, z.
        stiffness: K of each joint, N m / rad.
        links: (2 N,) length of the link after each joint, m, then their share of the weight.
        state: (N,) or (2 N,) deflection of the sample before, updated.
        powers: of a soft body that resists too, see `SoftBody`; None for none.
        weights: the same, at its modulus.

    Angles or loads that are not finite make all angles from there on NaN.
    """
    n, size = q.shape
    joints = len(links) // 2
    at, axes, curves = np.zeros((joints + 1, 3)), np.empty((size, 3)), np.empty((3 * joints, 3))
    levers = np.zeros((6, size))
    A, chol, b = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    f, at_free, B = np.empty(size), np.empty(size), np.empty((size, size))
    for t in range(n):
        if weights is not None:
            _resist(q[t], powers, weights, at_free, B)
        for _ in range(_ITERATIONS):
            if size == joints:
                _planar(q[t], state, loads[t], links, at, levers, A)
            else:
                _spatial(q[t], state, loads[t], links, at, axes, curves, b, A)
            for i in range(size):
                if size == joints:
                    b[i] = levers[0, i] * loads[t, 0] + levers[2, i] * loads[t, 2]
                    b[i] += levers[3, i] * loads[t, 3] + levers[5, i] * loads[t, 5]
                b[i] -= stiffness * state[i]
                A[i, i] += stiffness
            if weights is not None:
                _resist(q[t] + state, powers, weights, f, B)
                b += f - at_free
                A += B
            _solve(A, b, stiffness, chol)
            if not math.isfinite(b[0]):
                q[t:] = np.nan
                return
            largest = 0.0
            for i in range(size):
                step = min(max(b[i], -0.5), 0.5)  # keeps a near-singular step from throwing the spine about
                state[i] += step
                largest = max(largest, abs(step))
            if largest < _TOLERANCE:
                break
        for i in range(size):
            q[t, i] += state[i]


def along_a_line(q: np.ndarray, loads: np.ndarray, stiffness: float, links: np.ndarray) -> np.ndarray | None:
    """Loaded angles (n, N) of free ones (n, N) on one straight line, as one pressure bends a finger.

    For each of few loads the deflection along the line is solved at `_NODES` places and read between them by
    cubic interpolation, within 1e-7 rad. None where that is no less work than `solve`, or where
    something is not finite.
    """
    new = np.flatnonzero(np.r_[True, (loads[1:] != loads[:-1]).any(axis=1)])
    each, group = np.unique(loads[new], axis=0, return_inverse=True)
    span = np.ptp(q, axis=0)
    if len(each) * _NODES > _WORTH * len(q) or not span.max() > 0 or not np.isfinite(q).all():
        return None
    of = int(span.argmax())
    low, high = q[q[:, of].argmin()], q[q[:, of].argmax()]
    share = np.linspace(-1.5 / (_NODES - 4), 1 + 1.5 / (_NODES - 4), _NODES)
    nodes = np.tile(low + share[:, None] * (high - low), (len(each), 1))
    bent, state = nodes.copy(), np.zeros(q.shape[1])
    solve(bent, np.repeat(each, _NODES, axis=0), stiffness, links, state)
    deflection = (bent - nodes).reshape(len(each), _NODES, -1)
    out, at = q.copy(), np.repeat(group.ravel(), np.diff(np.append(new, len(q))))
    _add_between(out, of, at, nodes[0, of], nodes[1, of] - nodes[0, of], deflection)
    return out


@kernel
def _add_between(q, of, group, low, step, deflection):
    """Adds deflections (groups, nodes, N), cubic in column `of` of q, counted from low in steps."""
    last = deflection.shape[1] - 3
    for t in range(len(q)):
        s = (q[t, of] - low) / step
        i = min(max(int(s), 1), last)
        a, table = s - i, deflection[group[t]]
        before, here = -a * (a - 1) * (a - 2) / 6, (a + 1) * (a - 1) * (a - 2) / 2
        after, beyond = -(a + 1) * a * (a - 2) / 2, (a + 1) * a * (a - 1) / 6
        for j in range(q.shape[1]):
            q[t, j] += (
                before * table[i - 1, j]
                + here * table[i, j]
                + after * table[i + 1, j]
                + beyond * table[i + 2, j]
            )


@kernel
def sensitivities(q, free, loads, stiffness, links, by_markers, by_free, by_load, by_stiffness):
    """How outputs change with free angles, loads and stiffness, by one factorisation a sample (adjoint).

    The torques levers . load - K (q - free) are zero, so that of an output o, with A z = do/dq, do/dfree = K
    z, do/dload = levers z and do/dK = -(q - free) z.

    Of loaded and free angles (n, size) rad, with loads, stiffness and links as in `solve`, and outputs by tip
    x, y, z, mm, and bend towards +z and +y, rad, (n, D, 5); the last three arguments become outputs by free
    angles (n, D, size), by loads (n, D, 6) and by stiffness (n, D).
    """
    n, size = q.shape
    joints = len(links) // 2
    at, axes, curves = np.zeros((joints + 1, 3)), np.empty((size, 3)), np.empty((3 * joints, 3))
    levers = np.zeros((6, size))
    A, chol, z, none = np.empty((size, size)), np.empty((size, size)), np.empty(size), np.zeros(size)
    for t in range(n):
        if size == joints:
            _planar(q[t], none, loads[t], links, at, levers, A)
        else:
            _spatial(q[t], none, loads[t], links, at, axes, curves, z, A)
            _spatial_levers(links, at, axes, levers)
        for i in range(size):
            A[i, i] += stiffness
        for o in range(by_markers.shape[1]):
            for i in range(size):
                z[i] = by_markers[t, o, 3 + i % (size // joints)]
                for m in range(3):
                    z[i] += 1e3 * levers[m, i] * by_markers[t, o, m]
            if o == 0:
                _solve(A, z, stiffness, chol)
            else:
                _substitute(chol, z)
            for i in range(size):
                by_free[t, o, i] = stiffness * z[i]
                by_stiffness[t, o] -= z[i] * (q[t, i] - free[t, i])
                for m in range(6):
                    by_load[t, o, m] += levers[m, i] * z[i]


LEAST_SHARE = 1e-3  # of the whole stiffness, that is left to the controller at least


@dataclass(frozen=True)
class SoftBody:
    """Torque of a soft body by its joint angles."""

    powers: np.ndarray  # (T, N) of the joint angles in each term of the energy
    weights: np.ndarray  # (T,) of the terms, N m at a modulus of 1 MPa
    rest: np.ndarray  # (N,) joint angles at zero pressure, rad, where stiffnesses are compared
    error: float  # root mean square of what the fit leaves of the measured torques, share of theirs

    @classmethod
    def fit(cls, q: np.ndarray, torque: np.ndarray, rest: np.ndarray) -> "SoftBody":
        """From torques (R, N) in N m per MPa at joint angles (R, N) in rad.

        Raises InputError where there are too few poses.
        """
        powers = _terms(q.shape[1])
        if q.size < len(powers):
            raise InputError(f"{len(q)} poses are too few for a body with {len(powers)} terms; use more.")
        # f = -dU/dq
        design = -_derivative(powers, q).transpose(0, 2, 1).reshape(-1, len(powers))
        weights = np.linalg.lstsq(design, torque.ravel(), rcond=None)[0]
        left = torque.ravel() - design @ weights
        error = float(np.sqrt((left**2).mean() / (torque**2).mean()))
        return cls(powers, weights, np.asarray(rest, float), error)

    @property
    def resting(self) -> np.ndarray:
        """(N, N) stiffness at rest, N m/rad per MPa."""
        return self.stiffness(self.rest)

    def torque(self, q: np.ndarray) -> np.ndarray:
        """Torque f (..., N) in N m per MPa at joint angles (..., N)."""
        return -_derivative(self.powers, q).swapaxes(-1, -2) @ self.weights

    def stiffness(self, q: np.ndarray) -> np.ndarray:
        """-df/dq (N, N) in N m/rad per MPa at joint angles (N,), symmetric."""
        f, B = np.empty(len(q)), np.empty((len(q), len(q)))
        _resist(np.asarray(q, float), self.powers, self.weights, f, B)
        return B

    def alone(self, levers: np.ndarray) -> float:
        """Stiffness, N m/rad per MPa, of equal joints that yield as the body does to a force across the tip.

        Levers (N,) lead from each joint to the tip, in any unit.
        """
        return float(levers @ levers / (levers @ np.linalg.solve(self.resting, levers)))


def _terms(n: int) -> np.ndarray:
    chosen = [(i,) for i in range(n)] + list(combinations_with_replacement(range(n), 2))
    for order in (3, 4):
        chosen += [c for c in combinations_with_replacement(range(n), order) if c[-1] - c[0] <= 1]
    return np.array([[Counter(c)[i] for i in range(n)] for c in chosen])


def _derivative(powers: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(..., T, N) of each term by each joint angle."""
    q, columns = np.asarray(q, float)[..., None, :], []
    for i in range(powers.shape[1]):
        lower = powers.copy()
        lower[:, i] = np.maximum(lower[:, i] - 1, 0)
        columns.append(powers[:, i] * np.prod(q**lower, axis=-1))
    return np.stack(columns, axis=-1)


def share_of_controller(whole: float, body: np.ndarray, levers: np.ndarray) -> float:
    """K_c in N m/rad, what is left of a finger's whole stiffness K without its soft body; 0 where nothing is.

    Loaded poses give the total: with the moments w (N,) of a force across the straight finger's tip, in any
    unit, it yields as joints of stiffness K would, w^T (K_c + B)^-1 w = w^T w / K, with B (N, N) N m/rad the
    soft body's stiffness at rest.
    """
    values, vectors = np.linalg.eigh(body)
    share = (vectors.T @ levers) ** 2 / (levers @ levers)
    least = LEAST_SHARE * whole + max(0.0, -values.min())  # stable by itself

    def softness(K: float) -> float:
        return float((share / (K + values)).sum() - 1 / whole)

    if softness(least) <= 0:
        return 0.0
    from scipy.optimize import brentq  # half a second to start, for devices with a soft body alone

    return float(brentq(softness, least, whole + max(0.0, -values.min()) + least))


def controller_stiffness(whole: float, body: np.ndarray, levers: np.ndarray) -> float:
    """As `share_of_controller`, but at least a thousandth of the whole, for a search to pass through."""
    return max(share_of_controller(whole, body, levers), LEAST_SHARE * whole)


def loaded(q_free, loads, links, controller: float, modulus: float, body: SoftBody) -> np.ndarray:
    """Joint angles (n, N) in rad at rest under loads (n, 6), by Newton's method.

    Each starts from the deflection before. Loads and links are as in `solve`; the controller has K_c in N
    m/rad, the body a modulus in MPa.
    """
    q = np.array(q_free, float)
    soft = body.powers, modulus * body.weights
    solve(q, np.ascontiguousarray(loads), controller, links, np.zeros(q.shape[1]), *soft)
    return q
