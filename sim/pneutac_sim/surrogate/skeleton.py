"""The skeleton: the finger's spine as rigid links with hinges, which carry the mass of its soft body.

    M(q) (q'' + d q') + c(q, q') + D q' + K q = K q_target + f_r(q, q', p)

K and D are those of the controller of the material points' spine, q_target the joint targets, d the rate at
which a surrounding medium takes momentum (see `mpm.solve.simulate`), and c the forces of Coriolis and
centrifuge. Each particle goes with its nearest link, so M is the inertia of the whole body
wherever it follows its spine; f_r is then what the soft body does to the joints: the torque of its
elasticity, and where it lags behind.

All hinges are parallel. With the absolute angle phi_i of link i and complex numbers x + i z for the plane,
link k's centre of mass is sum_{j<=k} r_kj exp(i phi_j), where r_kj for j < k is the way from hinge j to the
next and r_kk the way from hinge k to the centre. With A = sum_k m_k conj(r_k)^T r_k Lagrange's equations are
M_ij = Re(A_ij e^{i(phi_j - phi_i)}) + I_i delta_ij and c_i = -sum_j Im(A_ij e^{i(phi_j - phi_i)}) phi_j'^2.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from pneutac_sim.errors import InputError
from pneutac_sim.least_squares import cholesky_solve
from pneutac_sim.mpm.body import Body, Spine
from pneutac_sim.mpm.solid import Links

G = 2 - np.sqrt(2)  # of TR-BDF2: share of the step that the trapezoidal rule takes
BACK = 1 / (G * (2 - G))  # weight of where that ends in the backward formula


@dataclass(frozen=True)
class Skeleton:
    """A planar chain of N links."""

    coupling: np.ndarray  # (N, N) complex A, kg m2
    inertia: np.ndarray  # (N,) of each link about its centre of mass, kg m2
    stiffness_nm_per_rad: float  # K of the controller
    damping_nms_per_rad: float  # D of the controller
    loss_per_s: float  # d, of the momentum

    @classmethod
    def of(cls, body: Body, spine: Spine, loss_per_s: float = 0.0) -> "Skeleton":
        """The skeleton of a finger of material points that loses momentum at this rate.

        Raises InputError where the spine bends in two planes, or a link carries no particle.
        """
        if spine.axes != 1:
            raise InputError(
                f"The skeleton of '{body.name}' would need two axes a joint; it has a finger's one."
            )
        joints = np.asarray(spine.joint_positions_m)
        links = Links.of(body, joints)
        centre = links.centre_m[1:, 0] + 1j * (links.centre_m[1:, 2] - spine.z_m)
        A, inertia = coupling(links.mass_kg[1:], centre, joints), links.inertia_kg_m2[1:, 1, 1]
        gains = spine.stiffness_nm_per_rad, spine.damping_nms_per_rad, loss_per_s
        return cls(A, inertia, *map(float, gains))

    def mass(self, q: np.ndarray) -> np.ndarray:
        """M (N, N) in kg m2 at joint angles `q` (N,) in rad."""
        return dynamics(self.coupling, self.inertia, np.asarray(q, float), np.zeros(len(q)))[0]

    def residual_torque(self, q, q_vel, q_acc, target) -> np.ndarray:
        """tau_r* = M (q'' + d q') + c + D q' + K q - tau_mpm (T, N) in N m, by inverse dynamics.

        Angles, rates and accelerations are (T, N) in rad, rad/s, rad/s2; tau_mpm is K times the joint targets
        (T, N).
        """
        out = np.empty(np.shape(q))
        for t in range(len(out)):
            M, c = dynamics(self.coupling, self.inertia, q[t], q_vel[t])
            out[t] = M @ (q_acc[t] + self.loss_per_s * q_vel[t]) + c
        damping = self.damping_nms_per_rad * np.asarray(q_vel)
        return out + damping + self.stiffness_nm_per_rad * (np.asarray(q) - target)


def coupling(mass: np.ndarray, centre: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """A (N, N) in kg m2, see above, of masses (N,) kg, centres (N,) x + i z and joints (N,) along x, m."""
    n = len(joints)
    A = np.zeros((n, n), complex)
    for k in range(n):
        r = np.append(np.diff(joints[: k + 1]), centre[k] - joints[k])
        A[: k + 1, : k + 1] += mass[k] * np.outer(r.conj(), r)
    return A


@njit(cache=True)
def dynamics(A, inertia, q, qd):
    """M (N, N) and c (N,) in joint angles, from those in absolute angles."""
    n = len(q)
    M, c = np.zeros((n, n)), np.zeros(n)
    turn, rate = np.empty(n, np.complex128), np.empty(n)
    angle, fast = 0.0, 0.0
    for i in range(n):  # not whole arrays: Numba takes seconds to compile the check of their shapes
        angle, fast = angle + q[i], fast + qd[i]
        turn[i], rate[i] = complex(math.cos(angle), math.sin(angle)), fast
    for i in range(n):
        for j in range(n):
            z = A[i, j] * np.conj(turn[i]) * turn[j]
            M[i, j] = z.real
            c[i] -= z.imag * rate[j] ** 2
        M[i, i] += inertia[i]
    # A joint turns its own link and all beyond it: sums from the tip.
    for i in range(n - 2, -1, -1):
        for j in range(n):
            M[i, j] += M[i + 1, j]
        c[i] += c[i + 1]
    for j in range(n - 2, -1, -1):
        for i in range(n):
            M[i, j] += M[i, j + 1]
    return M, c


@njit(cache=True)
def advance(A, inertia, K, D, loss, q, qd, target, end, extra, h, fastest):
    """One step of `h` seconds by TR-BDF2 (Bank et al. 1985): of second order, and stiff swings die away.

    First the trapezoidal rule over the share G of the step, then the backward formula over all of it; `a` is
    the same in both. `q` and `qd` (N,) are changed in place; `target` (N,) holds in the middle of the first
    part and `end` (N,) at the end of the step, rad; `extra` (N,) is the torque besides the controller's, N m.
    No rate exceeds `fastest` rad/s, beyond which Coriolis' forces would run away.
    """
    n = len(q)
    a = 0.5 * G * h
    middle, new = qd.copy(), qd.copy()
    for _ in range(2):  # the second time with the rates in the middle, for the second order of M and c
        M, c = dynamics(A, inertia, q + a * middle, middle)
        # (M (1 + a d) + a (D + a K)) q'_1 = M (1 - a d) q' + a (2 (f - c + K (target - q)) - (D + a K) q')
        b = (1.0 - a * loss) * (M @ qd)
        for i in range(n):
            b[i] += a * (2.0 * (extra[i] - c[i] + K * (target[i] - q[i])) - (D + a * K) * qd[i])
        _solve(M, (1.0 + a * loss), a * (D + a * K), b, new)
        for i in range(n):
            new[i] = min(max(new[i], -fastest), fastest)
            middle[i] = 0.5 * (qd[i] + new[i])
    # BDF2: y_2 = BACK y_1 - (BACK - 1) y_0 + a y_2', BACK = 1 / (G (2 - G)), a = G h / 2
    later, rate, angle = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        now = q[i] + 2.0 * a * middle[i]
        later[i] = now + (1.0 - G) * h * new[i]
        angle[i] = BACK * now - (BACK - 1.0) * q[i]
        rate[i] = BACK * new[i] - (BACK - 1.0) * qd[i]
        middle[i] = new[i] + (1.0 - G) / G * (new[i] - qd[i])
    # (M (1 + a d) + a (D + a K)) q'_2 = M rate + a (f - c + K (end - angle)), q_2 = angle + a q'_2
    M, c = dynamics(A, inertia, later, middle)
    b = M @ rate
    for i in range(n):
        b[i] += a * (extra[i] - c[i] + K * (end[i] - angle[i]))
    _solve(M, (1.0 + a * loss), a * (D + a * K), b, new)
    for i in range(n):
        new[i] = min(max(new[i], -fastest), fastest)
        q[i] = angle[i] + a * new[i]
        qd[i] = new[i]


@njit(cache=True)
def _solve(M, share, more, b, x):
    """(share M + more 1) x = b; `M` and `b` are used up."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            M[i, j] *= share
        M[i, i] += more
    cholesky_solve(M, b)
    for i in range(n):
        x[i] = b[i]
