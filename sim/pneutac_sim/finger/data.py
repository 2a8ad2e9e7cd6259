"""A recording prepared for the model: what drives it, what was measured, and in which unit errors count."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.finger import quantities
from pneutac_sim.finger.inputs import Inputs, pressure_columns
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import Twin

TARGETS = ("pose", "pressure")


@dataclass(frozen=True)
class BodyData:
    """A recording prepared once, for many simulations and fits."""

    inputs: Inputs  # what drives the model
    columns: tuple[str, ...]  # (D,) measured columns; those that count in the error come first
    measured: np.ndarray  # (n, D) their values
    scale: np.ndarray  # (D,) what one unit of each column is worth in the unit of the error
    counted: int  # how many of the columns count in the error
    unit: str  # of the error
    device: str  # `finger` or `arm`
    adjacent: np.ndarray  # (n,) True where a sample directly follows the one before in its trial

    @classmethod
    def of(
        cls,
        recording,
        twin: Twin,
        source: str = "auto",
        target: str = "pose",
        start: str | float | tuple[float, ...] = "auto",
        switch: float | np.ndarray | None = None,
    ) -> "BodyData":
        """Prepares a bench recording (anything with `.samples` and `.device`) of the twin's device.

        The target is `pose` (tip, angles, curvatures), or `pressure` for the measured pressure, which needs
        the command as its source. The others are as in `Inputs.from_samples`; start `auto` takes the twin's
        `pause_s` and switch None its `switch_share`, where it has one.

        Raises InputError: the devices differ or the wanted columns are missing.
        """
        if recording.device != twin.device:
            raise InputError(f"The recording is of a {recording.device}, the twin is of a {twin.device}.")
        if target not in TARGETS:
            raise InputError(f"target is '{target}'; it must be one of {', '.join(TARGETS)}.")
        samples = recording.samples
        if target == "pressure":
            source = "command"
            names = pressure_columns(twin.device)[1]
            missing = [c for c in names if c not in samples]
            if missing:
                raise InputError(f"The recording has no measured pressure (column '{missing[0]}').")
            groups = [(names, quantities.PRESSURE.unit)]
        else:
            groups = quantities.measured(samples, twin.device)
            if not groups:
                raise InputError(
                    "The recording has no tip_x_mm, tip_z_mm, bend_angle_rad, curvature or q_1_rad column."
                )
        unit = groups[0][1]
        columns = [c for names, _ in groups for c in names]
        known = twin.parameters
        if start == "auto" and "pause_s" in known:
            start = known["pause_s"].value
        if switch is None and "switch_share" in known:
            switch = known["switch_share"].value
        trials = getattr(recording, "meta", {}).get("trials")
        inputs = Inputs.from_samples(samples, twin.device, twin.length_mm, source, start, trials, switch)
        trial = np.asarray(samples["trial"])
        return cls(
            inputs=inputs,
            columns=tuple(columns),
            measured=np.stack([np.asarray(samples[c], dtype=float) for c in columns], axis=1),
            scale=np.array(
                [quantities.weight(u, unit, twin.length_mm) for names, u in groups for _ in names]
            ),
            counted=len(groups[0][0]),
            unit=unit,
            device=twin.device,
            adjacent=np.r_[False, trial[1:] == trial[:-1]],
        )

    def __len__(self) -> int:
        return len(self.measured)

    def error(self, residual: np.ndarray, mask: np.ndarray | None = None) -> float:
        """Root mean square Euclidean distance over samples of a residual (n, D), in `unit`."""
        counted = residual[:, : self.counted]
        return quantities.rms(counted if mask is None else counted[mask])

    def thin(self, samples: np.ndarray) -> "BodyData":
        """Only these samples (indices, (k,)); the model still runs through all of them."""
        adjacent = self.adjacent[samples] & (np.diff(samples, prepend=-2) == 1)
        inputs = self.inputs.thin(samples)
        return replace(self, inputs=inputs, measured=self.measured[samples], adjacent=adjacent)


@dataclass(frozen=True)
class Prediction:
    """What a twin predicts for a recording."""

    data: BodyData  # the prepared recording
    model: np.ndarray  # (n, D) predicted values of `data.columns`
    residual: np.ndarray  # (n, D) measured - model
    error: float  # root mean square Euclidean distance in `data.unit`
    left_out: dict[str, str]  # effects of the twin that could not act in full, and why


def simulate(twin: Twin, recording, effects: Sequence[str] | None = None) -> Prediction:
    """Runs a twin on a bench recording, or a `BodyData` prepared from one.

    `effects` take the place of the twin's own; those it does not have start at their defaults.
    """
    data = recording if isinstance(recording, BodyData) else BodyData.of(recording, twin)
    pipeline = Pipeline.of(twin, data.inputs, effects)
    run = pipeline.run(data.inputs, pipeline.theta(twin, data.inputs.pressure_range_kpa))
    model = pipeline.outputs(run, data.columns)
    residual = data.measured - model
    return Prediction(data, model, residual, data.error(residual), pipeline.left_out)
