"""What a baseline of the tactile benchmark is fitted to: one rest and one indentation image of a gel."""

from dataclasses import dataclass

import numpy as np

from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.gel.probe import THICKNESS_MM


@dataclass(frozen=True)
class Pair:
    """One rest and one indentation image of a gel, checked.

    Raises InputError: the pair is no rest and indentation image, see `check_pair`.
    """

    rest: np.ndarray  # image without contact, uint8 (H, W, 3)
    image: np.ndarray  # under the indenter, uint8, same shape
    press: Press  # which indenter, where and how deep
    px_per_mm: float  # scale of the images
    thickness_mm: float = THICKNESS_MM  # gel thickness

    def __post_init__(self):
        check_pair(self.rest, self.image, self.press, self.px_per_mm)
