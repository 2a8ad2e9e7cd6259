"""The soft body round a finger's spine: its torque on the joints, and how the spine yields to loads with it.

    K_c (q - q_free) = E (f(q) - f(q_free)) + tau(q)

The chamber drives the spine with a finite stiffness K_c, the same at every joint. The body's torque E f is
proportional to its modulus E, as in any elastic solid of one material, and f is measured on material points
(`pneutac_sim.mpm.soft_body`). It derives from an energy per modulus, a polynomial of the fourth order in the
joint angles: linear, and all products of two; of the third and fourth order those of one joint and its
neighbour, for a bend of one joint is felt no farther.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from pneutac_sim.effects.body_effect import kernel
from pneutac_sim.errors import InputError

ITERATIONS, TOLERANCE_RAD = 20, 1e-6
LARGEST_STEP_RAD = 0.5  # keeps a near-singular step from throwing the spine about
LEAST_SHARE = 1e-3  # of the whole stiffness, that is left to the controller at least


@dataclass(frozen=True)
class SoftBody:
    """Torque of a soft body by its joint angles.

    Attributes:
        powers: (T, N) of the joint angles in each term of the energy.
        weights: (T,) of the terms, N m at a modulus of 1 MPa.
        rest: (N,) joint angles at zero pressure, rad, where stiffnesses are compared.
        error: root mean square of what the fit leaves of the measured torques, share of theirs.
    """

    powers: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    error: float

    @classmethod
    def fit(cls, q: np.ndarray, torque: np.ndarray, rest: np.ndarray) -> "SoftBody":
        """From torques (R, N) in N m per MPa at joint angles (R, N) in rad.

        Raises:
            InputError: there are too few poses.
        """
        powers = _terms(q.shape[1])
        if q.size < len(powers):
            raise InputError(f"{len(q)} poses are too few for a body with {len(powers)} terms; use more.")
        # f = -dU/dq
        design = -_derivative(powers, q).transpose(0, 2, 1).reshape(-1, len(powers))
        weights = np.linalg.lstsq(design, torque.ravel(), rcond=None)[0]
        left = torque.ravel() - design @ weights
        return cls(
            powers, weights, np.asarray(rest, float), float(np.sqrt((left**2).mean() / (torque**2).mean()))
        )

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
        """What joints of one stiffness would have that yield as the body does to a force across the tip.

        Args:
            levers: (N,) from each joint to the tip, in any unit.

        Returns:
            N m/rad per MPa.
        """
        return float(levers @ levers / (levers @ np.linalg.solve(self.resting, levers)))


def _terms(n: int) -> np.ndarray:
    """(T, N) powers."""
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


@kernel
def _resist(q, powers, weights, f, B):
    """Torque into f (N,) and stiffness into B (N, N), both per modulus."""
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


def share_of_controller(whole: float, body: np.ndarray, levers: np.ndarray) -> float:
    """K_c in N m/rad, what is left of a finger's whole stiffness without its soft body; 0 where nothing is.

    Loaded poses give the total: with the moments w of a force across the straight finger's tip it yields as
    joints of stiffness K would, w^T (K_c + B)^-1 w = w^T w / K.

    Args:
        whole: K, N m/rad.
        body: (N, N) B, the soft body's stiffness at rest, N m/rad.
        levers: (N,) w, from each joint to the tip, in any unit.
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
    """Joint angles (n, N) in rad at rest under loads, by Newton's method, each from the deflection before.

    Args:
        q_free: (n, N) without loads, rad.
        loads: (n, 6) N: tip force x, y, z, then weight of the whole body x, y, z, as in `equilibrium.solve`.
        links: (2 N,) length of the link after each joint, m, then their share of the weight.
        controller: K_c, N m/rad.
        modulus: E, MPa.
        body: its torque.
    """
    q = np.array(q_free, float)
    _rest(q, np.ascontiguousarray(loads), links, controller, body.powers, modulus * body.weights)
    return q


@kernel
def _rest(q, loads, links, controller, powers, weights):
    """Unloaded joint angles to loaded ones."""
    n = q.shape[1]
    bend, free = np.zeros(n), np.empty(n)
    f, B, at_free = np.empty(n), np.empty((n, n)), np.empty(n)
    torque, stretch = np.empty(n), np.empty(n)
    for t in range(len(q)):
        free[:] = q[t]
        _resist(free, powers, weights, at_free, B)
        for _ in range(ITERATIONS):
            _moments(free + bend, loads[t], links, torque, stretch)
            _resist(free + bend, powers, weights, f, B)
            for i in range(n):
                torque[i] += f[i] - at_free[i] - controller * bend[i]
                B[i, i] += controller
                for j in range(n):
                    B[i, j] += stretch[max(i, j)]
            step = np.linalg.solve(B, torque)
            largest = 0.0
            for i in range(n):
                step[i] = min(max(step[i], -LARGEST_STEP_RAD), LARGEST_STEP_RAD)
                bend[i] += step[i]
                largest = max(largest, abs(step[i]))
            if not largest > TOLERANCE_RAD:
                break
        q[t] = free + bend


@kernel
def _moments(q, load, links, torque, stretch):
    """Moments of the loads about the joints, and less what they change by when the joint or one before turns.

    Turning a joint turns every link beyond it: d Im(conj(w) F) = -Re(conj(w) F) dq for a link w under F.
    """
    n, heading = len(q), q.sum()
    fx, fz, pull, turn = load[0], load[2], 0.0, 0.0
    for i in range(n - 1, -1, -1):
        x, z = links[i] * np.cos(heading), links[i] * np.sin(heading)
        half = 0.5 * links[n + i]  # of its own weight, which acts at the middle
        gx, gz = fx + half * load[3], fz + half * load[5]
        turn += x * gz - z * gx
        pull += x * gx + z * gz
        torque[i], stretch[i] = turn, pull
        fx, fz = gx + half * load[3], gz + half * load[5]
        heading -= q[i]
