"""What photographs of a gel show away from contacts, where no gel moves: noise, and drifts of light."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pneutac_sim.gel import optics
from pneutac_sim.gel.photograph import PressPhotograph, session_light
from pneutac_sim.gel.session import FAR_ENOUGH, LEFT_RADII

RECENT = 3  # presses before, of which something may be left that is no noise


def away(
    photographs: Sequence[PressPhotograph], differences: Iterable[np.ndarray], px_per_mm: float
) -> float:
    """Root mean square of differences (H, W, 3) away from contacts; 0 where no photograph shows enough."""
    out = []
    for p, difference in zip(photographs, differences, strict=True):
        far = ~p.near(px_per_mm)
        for e in p.earlier[-RECENT:]:
            far &= ~replace(p, press=e.press).near(px_per_mm, LEFT_RADII)
        if far.mean() > FAR_ENOUGH:
            out.append(np.mean(np.square(difference[far].astype(float))))
    return float(np.sqrt(np.mean(out))) if out else 0.0


def noise(photographs: Sequence[PressPhotograph], px_per_mm: float) -> float:
    """What is left away from contacts once each photograph's own drift of light is taken off, levels."""
    left = []
    for p in photographs:
        drift = optics.upsample(session_light(p, px_per_mm), *p.rest.shape[:2])
        left.append(p.image.astype(float) - p.rest - drift)
    return away(photographs, left, px_per_mm)
