"""A recording as a twin reads it."""

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.instants import instants
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import Twin


def read(recording: Recording, twin: Twin) -> BodyData:
    """A recording as a twin reads it: from the command, each step of it at its own instant."""

    def at(share) -> BodyData:
        return BodyData.of(recording, twin, source="command", switch=share)

    if "switch_share" not in twin.parameters:
        return at(None)
    pipeline = Pipeline.of(twin, at(None).inputs)
    theta = pipeline.theta(twin, at(None).inputs.pressure_range_kpa)
    return at(instants(recording, at, pipeline, theta))
