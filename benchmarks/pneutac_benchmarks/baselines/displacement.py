"""Surface displacement at image resolution, for baselines whose own mechanics is a slow particle simulation.

Tacchi and DOT-Sim press their elastomer with the material point method. Here `pneutac_sim.gel.surface` stands
in for it, with the decay length that fits the pair best, so that a comparison tells the light models apart
and none is held back by its geometry.
"""

import numpy as np
from scipy.optimize import minimize_scalar

from pneutac_benchmarks.baselines.pair import Pair
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.optics import gradient, upsample
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.surface import surface

DECAY_RANGE_MM = (0.3, 4.0)


class Displacement:
    """Displacement and slopes of a gel, pixel by pixel.

    Args:
        shape: height and width of the images.
        px_per_mm: their scale.
        thickness_mm: gel thickness.

    Attributes:
        decay_mm: length over which the surface recovers around a contact.
    """

    def __init__(self, shape: tuple[int, int], px_per_mm: float, thickness_mm: float):
        self._shape, self._thickness_mm, self.decay_mm = shape, thickness_mm, 1.2
        self._window_mm = shape[1] / px_per_mm, shape[0] / px_per_mm

    @classmethod
    def fit(cls, pair: Pair) -> "Displacement":
        """Searches the decay length under which slopes and depth explain most of indentation - rest."""
        model = cls(pair.rest.shape[:2], pair.px_per_mm, pair.thickness_mm)
        difference = (pair.image.astype(np.float32) - pair.rest).reshape(-1, 3)

        def error(log_decay: float) -> float:
            model.decay_mm = float(np.exp(log_decay))
            features = model.fields(pair.press).reshape(3, -1).T
            FF, Fd = features.T @ features, features.T @ difference
            return -float(np.sum(Fd * np.linalg.lstsq(FF, Fd, rcond=None)[0]))  # less |difference|^2

        bounds = np.log(DECAY_RANGE_MM)
        model.decay_mm = float(
            np.exp(minimize_scalar(error, bounds=bounds, method="bounded", options={"xatol": 0.03}).x)
        )
        return model

    def fields(self, press: Press) -> np.ndarray:
        """Slopes du/dx and du/dy, and u in mm (into the gel), float32 (3, H, W)."""
        depth = press.depths(self._window_mm, self._thickness_mm)
        cell = self._window_mm[0] / COLS, self._window_mm[1] / ROWS
        u = surface(depth, cell, self.decay_mm)
        return np.stack([upsample(f, *self._shape) for f in (*gradient(u, cell), u)])
