"""The effect library: physical mechanisms that a finger or its gel may have or lack, one file each."""

from pneutac_sim.effects.body_effect import BodyEffect, kernel
from pneutac_sim.effects.effect import STAGES, Effect, Parameter
from pneutac_sim.effects.registry import all_effects, body_effects, get_effect, in_order, sensor_effects
from pneutac_sim.effects.sensor_effect import SensorEffect, each_channel

__all__ = [
    "STAGES",
    "BodyEffect",
    "Effect",
    "Parameter",
    "SensorEffect",
    "all_effects",
    "body_effects",
    "each_channel",
    "get_effect",
    "in_order",
    "kernel",
    "sensor_effects",
]
