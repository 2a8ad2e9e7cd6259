"""The next experiment: where the predictions of two rivals differ most, over the noise."""

from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.diagnosis.law_programs import law_programs
from lerobot_pneutac.diagnosis.programs import HZ, SECONDS, Program, menu
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.instants import instants, pauses
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import Twin

PRESSURE_NOISE = 0.005  # of the range: an ordinary gauge
LOG_PRESSURE = "log the measured pressure"
LOG_ADVICE = "Log the measured pressure (pressure_kpa): it separates the pneumatics from the body."


@dataclass
class Separation:
    """How well one experiment separates two models."""

    name: str  # of the experiment
    advice: str  # what to do at the bench
    score: float  # sum of squared predicted differences over the noise's variance, in two minutes at 10 Hz
    time_s: np.ndarray  # (n,) of the program
    predictions: tuple[np.ndarray, np.ndarray]  # (n, k) headline columns (or pressure) of each model
    columns: list[str]  # their names

    def apart(self, unit: str, noise: float | None) -> str:
        """How far the models lie apart there, a sentence; `unit` and `noise` are of the headline error."""
        most = float(np.linalg.norm(self.predictions[0] - self.predictions[1], axis=1).max())
        if self.columns == ["pressure_kpa"]:
            return f"There the two predict pressures up to {most:.2g} kPa apart."
        times = f", {most / noise:.2g} times the noise" if noise else ""
        return f"There the two predict up to {most:.2g} {unit} apart{times}."


def separations(
    recording: Recording, a: Twin, b: Twin, floor: float, effects: tuple[str, ...] = ()
) -> list[Separation]:
    """All experiments of the menu and of the first twin's laws, the one that separates two twins most first.

    `floor` is the noise in the unit of the headline error. Where one of the `effects` in which they differ is
    of the pneumatics and pressure was not measured, measuring it is on the menu.
    """
    found = []
    pneumatic = {get_effect(e).stage == "pneumatics" for e in effects}
    logged = any(c.replace("cmd_", "") in recording.samples for c in recording.pressure_columns)
    constants = {e: {k: v.value for k, v in a.effects[e].items()} for e in effects if e in a.effects}
    for program in [*menu(recording), *law_programs(recording, constants)]:
        pair = predictions(recording, program, a, b)
        if pair is None:
            continue
        (ya, pa), (yb, pb), columns = pair
        each = SECONDS * HZ / len(program.samples)
        score = each * float(((ya - yb) ** 2).sum() / max(floor, 1e-12) ** 2)
        t = program.samples["time_s"].to_numpy()
        found.append(Separation(program.name, program.advice, score, t, (ya, yb), columns))
        if pneumatic == {True, False} and not logged:
            noise = PRESSURE_NOISE * max(float(np.ptp(program.samples[recording.pressure_columns])), 1e-9)
            score = each * float(((pa - pb) ** 2).sum() / noise**2)
            advice = f"{LOG_ADVICE} {program.advice}"
            found.append(
                Separation(f"{LOG_PRESSURE}, {program.name}", advice, score, t, (pa, pb), ["pressure_kpa"])
            )
    return sorted(found, key=lambda s: -s.score)


def predictions(recording: Recording, program: Program, a: Twin, b: Twin):
    """What two twins predict of a program, as `predict`, and the columns; None where one cannot follow it."""
    planned = Recording(recording.folder, recording.meta, program.samples, recording.device)
    out = []
    for twin in (a, b):
        bench = BodyData.of(planned, twin, source="command", start="held")
        try:
            seen, pressure = predict(twin, bench)
        except InputError:  # a load too heavy for the joints under these conditions
            return None
        if not np.isfinite(seen).all():
            return None
        out.append((seen, pressure))
    return out[0], out[1], list(bench.columns[: bench.counted])


def predict(twin: Twin, bench: BodyData) -> tuple[np.ndarray, np.ndarray]:
    """What a twin predicts: headline columns (n, k) and pressure in the chambers (n, chambers), kPa."""
    pipeline = Pipeline.of(twin, bench.inputs)
    run = pipeline.run(bench.inputs, pipeline.theta(twin, bench.inputs.pressure_range_kpa))
    return pipeline.outputs(run, bench.columns[: bench.counted]), run.pressure_kpa


def read(recording: Recording, twin: Twin) -> BodyData:
    """A recording as a twin reads it: from the command, each step of it at its own instant.

    Where the twin remembers runs, and pauses between them are not stated, each run has one that suits it.
    """
    start: str | tuple[float, ...] = "auto"

    def at(share) -> BodyData:
        return BodyData.of(recording, twin, source="command", start=start, switch=share)

    data = at(None)
    pipeline = Pipeline.of(twin, data.inputs)
    theta = pipeline.theta(twin, data.inputs.pressure_range_kpa)
    if "pause_s" in twin.parameters:
        start = pauses(recording, data, np.arange(len(data)), pipeline, theta) or start
    if "switch_share" not in twin.parameters:
        return at(None)
    usual = twin.parameters["switch_share"].value
    return at(instants(recording, at, pipeline, theta, usual))
