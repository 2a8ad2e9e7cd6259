"""The effects of the truths: every one is a function of a `World` in the module of its stage."""

from pneutac_truths.effects import air, command, drive, load, marker, material
from pneutac_truths.effects.table import EFFECTS, STAGES, Effect

__all__ = ["EFFECTS", "STAGES", "Effect", "air", "command", "drive", "load", "marker", "material"]
