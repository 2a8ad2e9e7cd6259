"""The effect library: physical mechanisms that a soft finger may have or lack, one file each."""

from pneutac_sim.effects.effect import STAGES, Effect, Parameter, kernel
from pneutac_sim.effects.registry import all_effects, get_effect, in_order

__all__ = ["STAGES", "Effect", "Parameter", "all_effects", "get_effect", "in_order", "kernel"]
