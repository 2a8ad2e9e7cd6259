"""Bodies at rest for many candidates at many pressures, all in one batch of material points.

What photographs are fitted by: parameters of drive and material, with bounds and first steps.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.stages import base_parameters
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.body import Material
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solid import parameter
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import TotalLagrangian
from pneutac_sim.twin import Twin, Value

STEP = 0.15  # of each gain, the paper's
# What soft prints and castings are made of, from Ecoflex to stiff Agilus30; near 0.5 steps get too small.
MATERIAL = {"youngs_modulus_mpa": (0.2, 4.0), "poissons_ratio": (0.38, 0.49)}


@dataclass(frozen=True)
class BodyParameters:
    """Parameters in the coordinates that a fit moves in: logarithms where only the magnitude counts."""

    twin: Twin  # whose other parameters stay as they are
    names: tuple[str, ...]  # (P,) the material's two last
    units: tuple[str, ...]  # (P,) as shown to people
    log: np.ndarray  # (P,) bool
    lower: np.ndarray  # (P,) bounds, coordinates
    upper: np.ndarray  # (P,) bounds, coordinates
    step: np.ndarray  # (P,) first step of a search, coordinates

    def __len__(self):
        return len(self.names)

    @property
    def of_pose(self) -> np.ndarray:
        """(P,) bool: those of the drive, which a body without material points has too."""
        return np.array([name not in MATERIAL for name in self.names])

    @property
    def prior_sd(self) -> np.ndarray:
        """(P,) standard deviation of the uniform distribution between the bounds, coordinates."""
        return (self.upper - self.lower) / np.sqrt(12)

    def coordinates(self, twin: Twin) -> np.ndarray:
        """(P,) of a twin's values, inside the bounds."""
        pipeline = Pipeline.of(twin)
        own = dict(zip(pipeline.names, pipeline.theta(twin), strict=True))
        values = np.array([own[n] if n in own else parameter(twin, n) for n in self.names])
        return np.clip(_coordinates(values, self.log), self.lower, self.upper)

    def values(self, x: np.ndarray) -> np.ndarray:
        """(..., P) physical values of coordinates (..., P)."""
        return np.where(self.log, np.exp(np.where(self.log, x, 0.0)), x)

    def twin_at(self, x: np.ndarray, ci95: dict | None = None) -> Twin:
        """A copy of the twin with the values at coordinates `x` (P,)."""
        new = self.twin.copy()
        for name, value in zip(self.names, self.values(x), strict=True):
            new.parameters[name] = Value(float(value), (ci95 or {}).get(name))
        return new


def body_parameters(twin: Twin, pressure_range_kpa: float) -> BodyParameters:
    """The drive parameters that data identify, and the material's two; of a recording up to this pressure.

    The first step is 15 % of each gain: of the overall gain by its own size, of the profile's parameters and
    the rest pressure by what changes a joint by about as much.
    """
    geometry = Pipeline.of(twin).geometry
    free = [p for p in base_parameters(geometry) if not p.fixed]
    limits = np.array([p.limits(pressure_range_kpa) for p in free])
    log = np.array([p.log for p in free])
    bounds = np.stack([_coordinates(column, log) for column in limits.T[1:]], 1)
    own = twin.parameters.get("gain_rad_per_kpa")
    half = max((geometry.n_joints - 1) / 2, 1.0)
    step = {
        "gain_rad_per_kpa": STEP * (abs(own.value) if own and own.value else limits[0, 0]),
        "gain_alpha": STEP / half,
        "gain_beta": STEP / half**2,
    }
    others = {p.name: STEP * (0.5 * pressure_range_kpa if p.range_power else 1.0) for p in free}
    material = np.array([np.log(MATERIAL["youngs_modulus_mpa"]), MATERIAL["poissons_ratio"]])
    return BodyParameters(
        twin,
        (*(p.name for p in free), *MATERIAL),
        (*(p.unit for p in free), "MPa", ""),
        np.array([*log, True, False]),
        np.concatenate([bounds[:, 0], material[:, 0]]),
        np.concatenate([bounds[:, 1], material[:, 1]]),
        np.array([*((others | step)[p.name] for p in free), STEP, STEP * np.ptp(material[1])]),
    )


def _coordinates(values: np.ndarray, log: np.ndarray) -> np.ndarray:
    """Logarithms of (P,) values where `log`; a value there that is not positive becomes a very small one."""
    return np.where(log, np.log(np.where(log, np.maximum(values, 1e-12), 1.0)), values)


def joint_targets(twin: Twin, pressures: np.ndarray, conditions: dict | None) -> np.ndarray:
    """(T, H) rad at pressures (T, chambers) kPa that have been held for long."""
    columns = pressures[:, 0] if pressures.shape[1] == 1 else pressures
    return devices.joint_targets(twin, columns, conditions=conditions)


class Bodies(NamedTuple):
    """K candidates at T pressures."""

    positions: np.ndarray  # (K, T, P, 3) of the particles, m
    gradients: np.ndarray  # (K, T, P, 3, 3) deformation gradients
    q: np.ndarray  # (K, T, H) joint angles, rad
    tips: np.ndarray  # (K, T, 3) of the spine, m


class Equilibria:
    """Finds bodies at rest, always from the same solved state, so that no answer depends on history.

    That is at coordinates `start` (P,), near which candidates lie, and pressures (T, chambers) kPa;
    `conditions` are what effects of the twin ask for.

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
        self.parameters, self.conditions = parameters, conditions
        self.pressures = np.asarray(pressures, float)
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

        Raises MpmDiverged: a body found no rest.
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
