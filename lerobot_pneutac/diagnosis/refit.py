"""Fits a twin with given effects the way a diagnosis does: air to the measured pressure, body to the pose."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.diagnosis import pneumatics
from lerobot_pneutac.diagnosis.engine import Engine, StageFitter
from lerobot_pneutac.diagnosis.experiment import predict
from lerobot_pneutac.diagnosis.parts import Parts
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin


@dataclass
class Refit:
    """A twin with all parameters fitted.

    Attributes:
        twin: with intervals.
        residual: (n, k) measured minus predicted from the commanded pressure.
        at_bound: parameters stopped by a bound.
        not_identified: parameters that the recording cannot tell, and why.
    """

    twin: Twin
    residual: np.ndarray
    at_bound: dict[str, str]
    not_identified: dict[str, str]

    @property
    def squared(self) -> np.ndarray:
        """(n,) squared Euclidean distance."""
        return (self.residual**2).sum(1)


def refit(
    twin: Twin,
    recording: Recording,
    effects: list[str],
    parts: Parts,
    done: Callable[[], None] = lambda: None,
) -> Refit:
    """Fits all parameters of the twin and of these effects to the training samples.

    Args:
        twin: where the fit starts.
        recording: cleaned.
        effects: all that shall be on.
        parts: gives the training samples.
        done: is called after each fit.
    """
    columns = pneumatics.measured_columns(recording)
    air_names = tuple(e for e in effects if pneumatics.is_pneumatic(e))
    bench = BodyData.of(recording, twin, source="command")
    if not columns or not air_names:
        with Engine(recording, parts.train, 1, done) as engine:
            found = StageFitter(engine, twin, "pose", "command").fit_all([tuple(effects)])[0]
        fitted, fits = found.twin, [found]
    else:
        with Engine(recording, parts.train, 1, done) as engine:
            air = StageFitter(engine, twin, "pressure", "command").fit_all([air_names])[0]
        noise = pneumatics.sensor_noise(recording, columns)
        driven = pneumatics.driven_by(recording, columns, air.residual, noise)
        with Engine(driven, parts.train, 1, done) as engine:
            names = tuple(e for e in effects if not pneumatics.is_pneumatic(e))
            body = StageFitter(engine, twin, "pose", "measured").fit_all([names])[0]
        fitted, fits = pneumatics.joined(body.twin, air.twin), [air, body]
    fitted.gel, fitted.arrays, fitted.history = twin.gel, twin.arrays, list(twin.history)
    residual = bench.measured[:, : bench.counted] - predict(fitted, bench)[0]
    return Refit(
        fitted,
        residual,
        {k: v for f in fits for k, v in f.at_bound.items()},
        {k: v for f in fits for k, v in f.not_identified.items()},
    )
