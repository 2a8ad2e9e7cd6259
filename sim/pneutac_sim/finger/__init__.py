"""The pneumatic finger: one pipeline from pressure command to markers, its calibration and its online use."""

from pneutac_sim.finger.data import BodyData, Prediction, simulate
from pneutac_sim.finger.fit import PipelineFit, fit
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.finger.pipeline import Pipeline, Run
from pneutac_sim.finger.stages import Geometry, base_parameters

__all__ = [
    "BodyData",
    "PipelineFit",
    "Geometry",
    "Inputs",
    "Pipeline",
    "Prediction",
    "PressurePipeline",
    "Run",
    "base_parameters",
    "fit",
    "simulate",
]
