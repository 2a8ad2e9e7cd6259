"""Recordings of soft pneumatic devices whose physics is known and shares nothing with the twin's model."""

from pneutac_truths.effects import EFFECTS, Effect
from pneutac_truths.truth import PAIRS, Truth, generate, write

__all__ = ["EFFECTS", "PAIRS", "Effect", "Truth", "generate", "write"]
