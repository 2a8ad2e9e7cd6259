"""What photographs are fitted by: parameters of drive and material, with bounds and first steps."""

from dataclasses import dataclass

import numpy as np

from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.stages import base_parameters
from pneutac_sim.mpm.parameters import parameter
from pneutac_sim.twin import Twin, Value

STEP = 0.15  # of each gain, the paper's
# What soft prints and castings are made of, from Ecoflex to stiff Agilus30; near 0.5 steps get too small.
MATERIAL = {"youngs_modulus_mpa": (0.2, 4.0), "poissons_ratio": (0.38, 0.49)}


@dataclass(frozen=True)
class BodyParameters:
    """Parameters in the coordinates that a fit moves in: logarithms where only the magnitude counts.

    Attributes:
        twin: whose other parameters stay as they are.
        names: (P,) the material's two last.
        units: (P,) as shown to people.
        log: (P,) bool.
        lower: (P,) bounds, coordinates.
        upper: (P,) bounds, coordinates.
        step: (P,) first step of a search, coordinates.
    """

    twin: Twin
    names: tuple[str, ...]
    units: tuple[str, ...]
    log: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    step: np.ndarray

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
    """The drive parameters that data identify, and the material's two.

    The first step is 15 % of each gain: of the overall gain by its own size, of the profile's parameters and
    the rest pressure by what changes a joint by about as much.

    Args:
        twin: a finger's or an arm's.
        pressure_range_kpa: largest pressure in the recording.
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
