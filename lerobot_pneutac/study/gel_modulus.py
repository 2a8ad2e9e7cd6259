"""Young's modulus of a gel from presses whose force was measured, by the law of `pneutac_sim.gel.force`.

At every imprint the law's force is proportional to the modulus, so that each press gives one; the gel's is
their geometric mean, as errors of depth and of the law are relative ones.

The baseline that a model must beat: the calibration's difference image, pasted.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_sim.errors import InputError
from pneutac_sim.gel.force import MATERIAL, MODULUS, MODULUS_MPA, GelForce
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.pair import PressPhotograph, press_px
from pneutac_sim.twin import Twin, Value


@dataclass(frozen=True)
class Modulus:
    """A gel's modulus from presses."""

    value_mpa: float  # the modulus
    ci95: tuple[float, float] | None  # its 95 % interval, by Student's t over presses; None of one press
    presses: int  # how many have a force
    off: float  # relative error of the law's forces on them, root mean square
    heldout: float | None  # the same of presses that were not fitted; None where there are none

    def parameter(self) -> dict[str, dict]:
        return {MODULUS: {"value": self.value_mpa, "ci95": self.ci95, "unit": "MPa"}}


def keep_modulus(twin: Twin, data: GelRecording) -> Modulus | None:
    """Fits the modulus to the rows of role `calibration` that have `force_n`, and writes it into the twin.

    Returns the modulus; None, with the twin as it was, if no row has a force. Raises InputError where the
    forces are not those of a rubber.
    """
    forced = [s for s in data.samples if s.force_n is not None]
    if not any(s.role == "calibration" for s in forced):
        return None
    soft = twin.copy()
    soft.parameters[MODULUS] = Value(MATERIAL[MODULUS])
    law = GelForce.of(soft)
    moduli = {
        r: np.log([_over(law, s) for s in forced if (s.role == "calibration") == r]) for r in (True, False)
    }
    mean, n = moduli[True].mean(), len(moduli[True])
    value = MATERIAL[MODULUS] * math.exp(mean)
    if not MODULUS_MPA[0] <= value <= MODULUS_MPA[1]:
        raise InputError(
            f"By force_n the gel's modulus would be {value:.2g} MPa, and a gel's lies between "
            f"{MODULUS_MPA[0]:g} and {MODULUS_MPA[1]:g}; give force_n in newton and depth_mm in millimetres."
        )
    ci95 = None
    if n > 1:
        half = stats.t.ppf(0.975, n - 1) * moduli[True].std(ddof=1) / math.sqrt(n)
        ci95 = value * math.exp(-half), value * math.exp(half)
    twin.parameters[MODULUS] = Value(value, ci95)
    off, heldout = (float(np.sqrt(np.mean((t - mean) ** 2))) if len(t) else None for t in moduli.values())
    return Modulus(value, ci95, n, off or 0.0, heldout)


def _over(law: GelForce, s: GelSample) -> float:
    assert s.force_n is not None
    return s.force_n / law.force(s.press.depths(law.window_mm, law.thickness_mm))


def modulus_sentence(modulus: Modulus | None, twin: Twin) -> str:
    if modulus is None:
        known = twin.parameters.get(MODULUS)
        value = known.value if known else MATERIAL[MODULUS]
        source = "keeps its modulus of" if known else "is assumed to have a modulus of"
        return f"No press has a force (column force_n), so the gel {source} {value:.2g} MPa."
    of = f"{modulus.presses} presses" if modulus.presses > 1 else "one press"
    between = " ({:.2g} to {:.2g})".format(*modulus.ci95) if modulus.ci95 else ""
    off = (
        ""
        if modulus.heldout is None
        else f"; the forces of the others are off by {100 * modulus.heldout:.0f} %"
    )
    return f"The force of {of} gives the gel a modulus of {modulus.value_mpa:.2g} MPa{between}{off}."


class Pasted:
    """Predicts the calibration's difference to rest, moved to the contact by whole pixels.

    It knows nothing of the indenter, its depth or where the light comes from, so a model worth having beats
    it wherever the test's contact differs from the calibration's.
    """

    def __init__(self, pair: PressPhotograph, px_per_mm: float):
        self._pair, self._px_per_mm = pair, px_per_mm

    def image(self, press: Press) -> np.ndarray:
        rest = self._pair.rest
        here, there = (press_px(p, rest.shape, self._px_per_mm) for p in (press, self._pair.press))
        difference = self._pair.image.astype(np.int16) - rest
        moved = shift(difference, round(here[0] - there[0]), round(here[1] - there[1]))
        return np.clip(rest + moved, 0, 255).astype(np.uint8)


def shift(image: np.ndarray, dx: int, dy: int) -> np.ndarray:
    """Moves an image (H, W, C) by whole pixels, right and down; zeros come in."""
    h, w = image.shape[:2]
    out = np.zeros_like(image)
    if abs(dx) < w and abs(dy) < h:
        out[max(dy, 0) : h + min(dy, 0), max(dx, 0) : w + min(dx, 0)] = image[
            max(-dy, 0) : h + min(-dy, 0), max(-dx, 0) : w + min(-dx, 0)
        ]
    return out
