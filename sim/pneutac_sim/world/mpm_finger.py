"""The soft body round the world's spine, of material points: what `surrogate.finger` stands in for.

A stiff servo holds the spine of the material points where the world's is, and f is the torque of the body on
its joints there. Each control step two bodies are brought to rest, one as the world's finger is bent and one
as pressure alone would bend it, starting from the step before: 25 substeps while nothing moves, about 650
(0.25 s) while it does. Moving them through the same 1/15 s in true time takes 2,200, always; what
that would add, the slow motion of the finger with the mass of its sensor, is the world's own.

What is missing: the soft body does not feel where it is touched, so its skin is not dented. The gel is
`world.mpm_gel`'s.
"""

import numpy as np

from pneutac_sim.mpm import devices
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.surrogate import programs
from pneutac_sim.surrogate.stiffness import controller_stiffness
from pneutac_sim.twin import Twin

NEAR_RAD = 0.1  # of the bends by which the body's stiffness is measured
TOLERANCE = 1e-3  # of unbalanced forces; torques are then known to 1 mN m, 0.2 mm at the tip


class MpmFinger:
    """The soft body of one finger.

    Args:
        twin: of a finger.
        particles: about how many.
        device: see `pneutac_sim.mpm.runtime.start`.

    Attributes:
        controller_nm_per_rad: K_c, see `stiffness.controller_stiffness`.
        solver: the bodies, for pictures; the first is the one that is loaded.
        substeps: taken in the last step.
        in_range: always; there is no range to leave.

    Raises:
        InputError: the body is stiffer than the whole finger.
    """

    in_range = True

    def __init__(self, twin: Twin, particles: int = 4000, device: str = "auto"):
        self.solver = devices.finger(twin, batch=2, particles=particles, device=device)
        self._servo = float(self.solver.spine.stiffness_nm_per_rad)
        n = len(twin.spine_joint_positions_mm)
        self._J, self.substeps = np.zeros((n, n)), 0
        self.reset()
        # A neo-Hookean body's own stiffness hardly changes with its bend (10 % up to 15 kPa): once is enough.
        columns, at = [], programs.joint_targets(twin, 0.0)
        for i in range(n):
            apart = NEAR_RAD * np.eye(n)[i]
            q, f = self._hold(at + np.stack([apart, -apart]))
            self.reset()
            columns.append((q[0] - q[1], f[0] - f[1]))
        dq, df = (np.stack(c) for c in zip(*columns, strict=True))
        J = np.linalg.solve(dq, df).T
        self._J = 0.5 * (J + J.T)
        self.controller_nm_per_rad = controller_stiffness(twin, self._J)

    def reset(self) -> None:
        self._f, self._begun = np.zeros((2, len(self._J))), False

    def torque(self, q_free: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the body does to the joints at `q` beyond what it does at `q_free`, and its derivative by `q`.

        Args:
            q_free: (N,) where the unloaded finger rests, rad.
            q: (N,) joint angles, rad.

        Returns:
            (N,) in N m and (N, N) in N m/rad.
        """
        wanted = np.stack([q, q_free]).astype(float)
        held, f = self._hold(wanted)
        at = f + (wanted - held) @ self._J  # the servo holds slightly off
        return at[0] - at[1], self._J

    def _hold(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles (2, N) near those wanted, and the body's torques there (2, N) in N m."""
        target = q - self._f / self._servo
        rest = solve_equilibrium(self.solver, Loads(q_cmd=target), TOLERANCE, warm=self._begun)
        self._begun, self.substeps, self._f = True, rest.substeps, rest.body_torque.astype(float)
        return rest.q.astype(float), self._f
