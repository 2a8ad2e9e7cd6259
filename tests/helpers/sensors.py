"""Twins whose touch sensor is no DIGIT, and residual fields."""

from dataclasses import replace

import numpy as np

from pneutac_sim.gel.model import GelModel, rest_image
from pneutac_sim.gel.residual import FEATURES, PLACE, ResidualField
from pneutac_sim.twin import Twin

WIDE = (480, 640, 3)  # height, width and channels of what many USB cameras give


def wide_twin() -> Twin:
    """The paper's finger with a gel of 18.6 x 14 mm, seen by a camera of 640 x 480 px."""
    twin = Twin.builtin()
    replace(GelModel.builtin(), rest_image=rest_image(WIDE), px_per_mm=34.4).into_twin(twin)
    return twin


def wavy(rng) -> ResidualField:
    """A field of a few broad bumps of some levels, which reaches over the whole gel."""
    centres = np.repeat(rng.normal(0, 0.7, (3, 6, FEATURES)), 30, 1).astype(np.float32)
    centres[..., PLACE] = rng.uniform(-1, 1, (3, 180, 2))
    return ResidualField(centres, np.repeat(rng.normal(0, 3, (3, 6)), 30, 1).astype(np.float32))
