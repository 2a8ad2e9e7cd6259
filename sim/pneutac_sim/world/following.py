"""Torques with which the free finger goes where the pipeline says, at every substep.

A pipeline that was calibrated on a bench holds the finger's own inertia and damping in its lags. So that they
are not counted twice the world drives the spine with the inverse of its own free response,

    tau = M(q_d) q_d'' + c(q_d, q_d') + D q_d' + K q_d

along a path q_d through the pipeline's angles. What is left, M e'' + D e' + K e = load with e = q - q_d, is
how the finger gives way to contact and to the arm's motion: there its mass, damping and stiffness act.
"""

import mujoco
import numpy as np
from numba import njit

from pneutac_sim.surrogate.skeleton import coupling
from pneutac_sim.world import ball_kernel
from pneutac_sim.world.spine import BALL


class Follower:
    """The chain of a finger in a model, with all that its links carry.

    Args:
        model: of a scene with a finger of hinges or balls `spine_1` to `spine_N` that begins with the body
            `finger`.
        joints: N.
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
        """Torques of the substeps of one control step.

        The rate goes without a jump from what it is to that of a straight line from `before` to `after`, by
        the parabola that ends there.

        Args:
            before: (N,) angles where the path is, of balls (N, 2), rad.
            rate: of the path there, shaped alike, rad/s.
            after: angles at the end of the control step, rad.
            K: (N, N) stiffness of the joints, N m/rad.
            D: (N, N) their damping, N m s/rad.
            steps: S.

        Returns:
            (S, N) in N m, of balls (S, 3 N), and the rate at the end.
        """
        slope = (after - before) / (steps * self._h)
        if self._balls is not None:
            turned = np.empty((steps, len(before), 3))
            ball_kernel.torques(
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
    turn, pull = np.empty(n, np.complex128), np.empty(n, np.complex128)
    for k in range(steps):
        s = (k + 1) / steps
        heading, spin, faster = 0.0, 0.0, 0.0  # of absolute angles, see `skeleton`
        for i in range(n):
            # the sum of s (1 - s) is (S^2 - 1) / (6 S), so that all steps together go as far as the slope
            bow = 3.0 * steps / (steps + 1.0) * (slope[i] - rate[i])
            new[i] = rate[i] + (slope[i] - rate[i]) * s + bow * s * (1.0 - s)
            heading += q[i]
            spin += v[i]
            faster += (new[i] - v[i]) / h
            turn[i] = np.exp(1j * heading)
            pull[i] = turn[i] * (faster + 1j * spin * spin)
        torque = 0.0
        for i in range(n - 1, -1, -1):  # a joint turns its own link and all beyond it
            for j in range(n):
                torque += (A[i, j] * np.conj(turn[i]) * pull[j]).real
            torque += inertia[i] * faster
            faster -= (new[i] - v[i]) / h
            out[k, i] = torque
        for i in range(n):
            for j in range(n):
                out[k, i] += K[i, j] * q[j] + D[i, j] * new[j]
        for i in range(n):  # not whole arrays: numba takes two seconds to compile the check of their shapes
            q[i] += h * new[i]
            v[i] = new[i]
