"""The effects of the truths: every one is a function of a `World` in the module of its stage.

Those of the stage `command` are in `air`.
"""

from pneutac_truths.effects import air, drive, load, marker, material
from pneutac_truths.effects.table import EFFECTS, STAGES, Effect

__all__ = ["EFFECTS", "STAGES", "Effect", "air", "drive", "load", "marker", "material"]
