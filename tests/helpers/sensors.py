"""Twins whose touch sensor is no DIGIT."""

from dataclasses import replace

from pneutac_sim.gel.model import GelModel, rest_image
from pneutac_sim.twin import Twin

WIDE = (480, 640, 3)  # height, width and channels of what many USB cameras give


def wide_twin() -> Twin:
    """The paper's finger with a gel of 18.6 x 14 mm, seen by a camera of 640 x 480 px."""
    twin = Twin.builtin()
    replace(GelModel.builtin(), rest_image=rest_image(WIDE), px_per_mm=34.4).into_twin(twin)
    return twin
