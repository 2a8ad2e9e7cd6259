"""Tacchi (Chen et al. 2023; Sun et al. 2024): a deformed elastomer under Phong's lighting.

Tacchi deforms the elastomer with the material point method and lights its depth map as the GelSight
simulation of Gomes et al. (RA-L 2021) does:

    I = k_a I_a + sum over lights of c (k_d (N . L) + k_s (R . V)^alpha),

N the surface normal, L the direction to a light of colour c, R its mirror direction and V the view, along the
gel's axis; the deeper the contact, the darker the background (their internal shadow). Differences:

- `displacement` stands in for the particles.
- What users choose by hand, directions, colours, strengths and exponents of three lights and the internal
  shadow, is fitted to the pair by least squares, and highlights may have a colour of their own.
- The ambient image is what the lights on flat gel leave of the rest image, so that no contact renders as the
  rest image exactly.
"""

import numpy as np
from scipy.optimize import least_squares

from pneutac_benchmarks.baselines.displacement import Displacement
from pneutac_benchmarks.baselines.pair import Pair
from pneutac_sim.gel.indenter import Press

LIGHTS = 3
FIT_PIXELS = 2500
# Starts: elevation of the lights above the gel, rad, and exponent of their highlights.
STARTS = ((0.3, 5.0), (0.8, 5.0), (0.3, 30.0))

# Of one light: azimuth, elevation [rad], diffuse colour R, G, B and specular colour [levels], log exponent;
# after the lights, the internal shadow.
_LOWEST = [-np.inf, 0.02, 0, 0, 0, 0, 0, 0, 0.0]
_HIGHEST = [np.inf, 1.5, 500, 500, 500, 500, 500, 500, np.log(100)]


class Tacchi:
    """Phong's lighting of a displaced surface."""

    def __init__(
        self, rest: np.ndarray, displacement: Displacement, thickness_mm: float, parameters: np.ndarray
    ):
        self._rest, self._displacement = rest, displacement
        self._thickness_mm, self._parameters = thickness_mm, parameters

    @classmethod
    def fit(cls, pair: Pair) -> "Tacchi":
        """Fits the lights from a few starts and keeps the best."""
        displacement = Displacement.fit(pair)
        fields = displacement.fields(pair.press)
        touched = np.flatnonzero(fields[2] > 0.02 * fields[2].max())
        touched = touched[:: max(1, len(touched) // FIT_PIXELS)]
        fields = fields.reshape(3, -1)[:, touched].astype(np.float64)
        background = pair.rest.reshape(-1, 3)[touched].astype(np.float64)
        target = pair.image.reshape(-1, 3)[touched] - background
        slope_light = np.linalg.lstsq(fields[:2].T, target, rcond=None)[0].T  # (3, 2) levels per unit slope

        def residual(parameters):
            return (_change(parameters, fields, background, pair.thickness_mm) - target).ravel()

        bounds = np.array(_LOWEST * LIGHTS + [-1.0]), np.array(_HIGHEST * LIGHTS + [1.0])
        fits = [
            least_squares(residual, _start(slope_light, *start), bounds=bounds, x_scale=_scale(), max_nfev=40)
            for start in STARTS
        ]
        best = min(fits, key=lambda f: f.cost)
        return cls(pair.rest, displacement, pair.thickness_mm, best.x)

    def image(self, press: Press) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3)."""
        fields = self._displacement.fields(press).reshape(3, -1)
        background = self._rest.reshape(-1, 3).astype(np.float64)
        image = background + _change(self._parameters, fields, background, self._thickness_mm)
        return np.clip(image, 0, 255).round().astype(np.uint8).reshape(self._rest.shape)


def _start(slope_light: np.ndarray, elevation: float, exponent: float) -> np.ndarray:
    """One light for each channel, from where that channel brightens."""
    parameters = []
    for k, (lx, ly) in enumerate(slope_light):
        diffuse, specular = np.full(3, 5.0), np.full(3, 2.0)
        diffuse[k] += np.hypot(lx, ly) / np.cos(elevation)
        # depth grows away from the side that faces a light, hence the signs
        parameters += [
            np.arctan2(-ly, -lx),
            elevation,
            *np.minimum(diffuse, 400),
            *specular,
            np.log(exponent),
        ]
    return np.array([*parameters, 0.05])


def _scale() -> np.ndarray:
    """Typical size of each parameter's steps."""
    return np.array([0.3, 0.3, *[30.0] * 6, 1.0] * LIGHTS + [0.1])


def _change(
    parameters: np.ndarray, fields: np.ndarray, background: np.ndarray, thickness_mm: float
) -> np.ndarray:
    """Image less rest image, (n, 3) levels.

    Args:
        parameters: of the lights, and the internal shadow.
        fields: slopes along x and y, and displacement in mm, (3, n).
        background: rest image at the same pixels, (n, 3) levels.
        thickness_mm: gel thickness.
    """
    ux, uy, u = fields
    nz = 1 / np.sqrt(1 + ux * ux + uy * uy)
    lit, ambient = np.zeros_like(background), background.copy()
    for azimuth, elevation, *colours, log_exponent in parameters[:-1].reshape(LIGHTS, -1):
        lx, ly = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
        lz, alpha = np.sin(elevation), np.exp(log_exponent)
        cosine = np.maximum((lz - ux * lx - uy * ly) * nz, 0)
        mirrored = np.maximum(2 * cosine * nz - lz, 0) ** alpha  # R . V with the view along z
        lit += np.outer(cosine, colours[:3]) + np.outer(mirrored, colours[3:])
        ambient -= lz * np.array(colours[:3]) + lz**alpha * np.array(colours[3:])
    return ambient * (1 - parameters[-1] * u / thickness_mm)[:, None] + lit - background
