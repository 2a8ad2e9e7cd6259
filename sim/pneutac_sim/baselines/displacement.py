"""Surface displacement at image resolution, for baselines whose own mechanics is a slow particle simulation.

Tacchi and DOT-Sim press their elastomer with the material point method. Here the same surface stands in for
it that `pneutac_sim.gel` renders, with the decay length calibrated on the same pair, so that a comparison
tells the light models apart and none is held back by its geometry.
"""

import numpy as np

from pneutac_sim.gel.fit import fit_gel, press_depth
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import gradient, upsample
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.surface import surface


class Displacement:
    """Displacement and slopes of a calibrated gel, pixel by pixel.

    Args:
        gel: whose size, thickness and decay length count; its light does not.
    """

    def __init__(self, gel: GelModel):
        self._gel = gel

    @classmethod
    def fit(
        cls, rest: np.ndarray, indentation: np.ndarray, press: Press, px_per_mm: float, thickness_mm: float
    ) -> "Displacement":
        """Calibrates the decay length, see `pneutac_sim.gel.fit.fit_gel`, whose errors it raises."""
        gel, _ = fit_gel(rest, indentation, press, px_per_mm, thickness_mm=thickness_mm)
        return cls(gel)

    def fields(self, press: Press) -> np.ndarray:
        """Slopes du/dx and du/dy, and u in mm (into the gel), float32 (3, H, W)."""
        gel = self._gel
        cell = gel.window_mm[0] / COLS, gel.window_mm[1] / ROWS
        u = surface(press_depth(press, gel), cell, gel.decay_mm)
        h, w = gel.rest_image.shape[:2]
        return np.stack([upsample(f, h, w) for f in (*gradient(u, cell), u)])
