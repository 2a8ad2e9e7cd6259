"""The two rows that keep a comparison honest: nothing but the rest image, and the calibration pasted."""

import numpy as np

from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.pair import Pair, press_px


class RestAlone:
    """Predicts that no contact shows."""

    def __init__(self, rest: np.ndarray):
        self._rest = rest

    @classmethod
    def fit(cls, pair: Pair) -> "RestAlone":
        """Keeps the rest image, uint8 (H, W, 3); the rest is checked and not used."""
        return cls(pair.rest)

    def image(self, press: Press) -> np.ndarray:
        return self._rest.copy()


class Pasted:
    """Predicts the calibration's difference to rest, moved to the contact by whole pixels.

    It knows nothing of the indenter, its depth or where the light comes from, so a model worth having beats
    it wherever the test's contact differs from the calibration's.
    """

    def __init__(self, rest: np.ndarray, difference: np.ndarray, press: Press, px_per_mm: float):
        self._rest, self._difference = rest, difference
        self._press, self._px_per_mm = press, px_per_mm

    @classmethod
    def fit(cls, pair: Pair) -> "Pasted":
        """Keeps indentation - rest, both uint8 (H, W, 3), and where the contact was."""
        return cls(pair.rest, pair.indentation.astype(np.int16) - pair.rest, pair.press, pair.px_per_mm)

    def image(self, press: Press) -> np.ndarray:
        here, there = (press_px(p, self._rest.shape, self._px_per_mm) for p in (press, self._press))
        moved = shift(self._difference, round(here[0] - there[0]), round(here[1] - there[1]))
        return np.clip(self._rest + moved, 0, 255).astype(np.uint8)


def shift(image: np.ndarray, dx: int, dy: int) -> np.ndarray:
    """Moves an image (H, W, C) by whole pixels, right and down; zeros come in."""
    h, w = image.shape[:2]
    out = np.zeros_like(image)
    if abs(dx) < w and abs(dy) < h:
        out[max(dy, 0) : h + min(dy, 0), max(dx, 0) : w + min(dx, 0)] = image[
            max(-dy, 0) : h + min(-dy, 0), max(-dx, 0) : w + min(-dx, 0)
        ]
    return out
