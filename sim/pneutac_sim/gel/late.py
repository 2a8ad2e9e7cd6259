"""What earlier presses leave in a gel that creeps, and how the next press lies on it.

See the effect `gel_creep`. A press meets a face that is still r deep: what it adds is the surface under an
imprint that is less deep by r, so that the face lies on the indenter as it does on a gel that does not creep.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.surface import surface

Branches = Sequence[tuple[float, float]]

LEAST_MM = 2e-4  # what is left of a press that is not drawn: a fiftieth of a grey level


@dataclass(frozen=True)
class Earlier:
    """A press that was over before a photograph was taken.

    Attributes:
        press: which indenter, where and how deep.
        held_s: how long it was in the gel.
        since_s: from its release to the photograph.
    """

    press: Press
    held_s: float
    since_s: float


class Memory:
    """What is left in a gel of a simulator, step by step; after one press it is `share_left` of its surface.

    Args:
        branches: (share, time in s) each.
    """

    def __init__(self, branches: Branches):
        share, time = np.array(branches, np.float64).reshape(-1, 2).T
        self._share, self._time_s = share[:, None, None], time[:, None, None]
        self._late, self._held, self._at_s = np.zeros((len(share), ROWS, COLS)), np.zeros((ROWS, COLS)), 0.0

    def left_mm(self, at_s: float) -> np.ndarray | None:
        """Displacement (80, 59) that is left now, or None; a clock that goes back starts again."""
        if at_s < self._at_s:
            self._late[:], self._held = 0.0, np.zeros((ROWS, COLS))
        self._late += -np.expm1(-max(at_s - self._at_s, 0.0) / self._time_s) * (self._held - self._late)
        self._at_s = at_s
        left = (self._share * self._late).sum(0)
        return np.float32(left) if left.max() > LEAST_MM else None

    def hold(self, surface_mm: np.ndarray | None) -> None:
        """The displacement (80, 59) under what presses from now on; None where nothing does."""
        self._held = np.zeros((ROWS, COLS)) if surface_mm is None else surface_mm


def branches_of(gel: GelModel) -> list[tuple[float, float]]:
    """Branches of all the gel's effects, in order."""
    return [b for effect, values in gel.acting if effect.late is not None for b in effect.late(values)]


def pressed_on(imprint_mm: np.ndarray, left_mm: np.ndarray | None, cell_mm, decay_mm: float) -> np.ndarray:
    """Displacement (80, 59) in mm under an imprint on a face that earlier presses left uneven."""
    if left_mm is None:
        return surface(imprint_mm, cell_mm, decay_mm)
    return left_mm + surface(np.maximum(imprint_mm - left_mm, 0), cell_mm, decay_mm)
