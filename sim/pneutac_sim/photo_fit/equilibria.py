"""Bodies at rest for many candidates at many pressures, all in one batch of material points."""

from typing import NamedTuple

import numpy as np

from pneutac_sim.mpm import devices
from pneutac_sim.mpm.body import Material
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import TotalLagrangian
from pneutac_sim.photo_fit.parameters import BodyParameters
from pneutac_sim.twin import Twin


def joint_targets(twin: Twin, pressures: np.ndarray, conditions: dict | None) -> np.ndarray:
    """(T, H) rad at pressures (T, chambers) kPa that have been held for long."""
    columns = pressures[:, 0] if pressures.shape[1] == 1 else pressures
    return devices.joint_targets(twin, columns, conditions=conditions)


class Bodies(NamedTuple):
    """K candidates at T pressures.

    Attributes:
        positions: (K, T, P, 3) of the particles, m.
        gradients: (K, T, P, 3, 3) deformation gradients.
        q: (K, T, H) joint angles, rad.
        tips: (K, T, 3) of the spine, m.
    """

    positions: np.ndarray
    gradients: np.ndarray
    q: np.ndarray
    tips: np.ndarray


class Equilibria:
    """Finds bodies at rest, always from the same solved state, so that no answer depends on history.

    Args:
        parameters: what candidates differ in.
        start: (P,) coordinates near which they lie.
        pressures: (T, chambers) kPa.
        conditions: what effects of the twin ask for.
        particles: of a body, about.
        device: see `mpm.runtime.start`.

    Attributes:
        body: the straight one.
        spine: of every body.
    """

    def __init__(
        self,
        parameters: BodyParameters,
        start: np.ndarray,
        pressures: np.ndarray,
        conditions: dict | None = None,
        particles: int = 4000,
        device: str = "auto",
    ):
        self.parameters, self.pressures, self.conditions = (
            parameters,
            np.asarray(pressures, float),
            conditions,
        )
        one = devices.BODIES[parameters.twin.device](parameters.twin, particles=particles, device=device)
        self.body, self.spine, self.device = one.body, one.spine, one.device
        self._target = self.targets(start[None])[0]
        solver = self._solver(start[None], len(self._target))
        state = solve_equilibrium(solver, Loads(q_cmd=self._target))
        self._nodes, self._q = solver.nodes(), state.q
        self.first = self._bodies(solver, state, 1)

    def targets(self, x: np.ndarray) -> np.ndarray:
        """(K, T, H) rad of candidates (K, P)."""
        twins = map(self.parameters.twin_at, x)
        return np.stack([joint_targets(t, self.pressures, self.conditions) for t in twins])

    def solve(self, x: np.ndarray) -> Bodies:
        """Candidates (K, P) in coordinates, at every pressure.

        Raises:
            MpmDiverged: a body found no rest.
        """
        k, t = len(x), len(self.pressures)
        solver = self._solver(x, k * t)
        # Each body begins as the solved one at its pressure, bent on by the difference of joint targets.
        tile = (k, 1, 1)
        solver.apply(Loads(q_cmd=np.tile(self._target, tile[:2])))
        solver.set_q(np.tile(self._q, tile[:2]))
        solver.set_nodes(np.tile(self._nodes, tile))
        target = self.targets(x).reshape(k * t, -1)
        return self._bodies(solver, solve_equilibrium(solver, Loads(q_cmd=target), warm=True), k)

    def _solver(self, x: np.ndarray, batch: int) -> TotalLagrangian:
        density = devices.parameter(self.parameters.twin, "density_kg_m3")
        named = [dict(zip(self.parameters.names, v, strict=True)) for v in self.parameters.values(x)]
        each = [Material(1e6 * n["youngs_modulus_mpa"], n["poissons_ratio"], density) for n in named]
        materials = [m for m in each for _ in range(batch // len(x))]
        return TotalLagrangian(self.body, self.spine, batch, materials, self.device)

    def _bodies(self, solver, state, k: int) -> Bodies:
        tips = devices.spine_points(solver, state.q)[:, -1]
        return Bodies(
            *(a.reshape(k, -1, *a.shape[1:]) for a in (state.positions, state.gradients, state.q, tips))
        )
