"""How well a twin predicts rows of a recording, and whether requested manual changes were made."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lerobot_pneutac.diagnosis.experiment import predict, read
from lerobot_pneutac.diagnosis.hands import GRAVITY
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.twin import Twin

SHARES = (0.0, 0.25, 0.5, 0.67, 1.5, 2.0, 3.0, 4.0)  # of the weight that was asked for, tried
CLEARLY = 0.7  # of the error with what was asked for: below, it was something else


def error_of(twin: Twin, recording: Recording, rows: slice = slice(None), favour: bool = False) -> float:
    """Root mean square headline error of a twin on some rows of a recording, driven by the command.

    Args:
        twin: of the recording's device.
        recording: of a finger, with all that came before these rows.
        rows: that count.
        favour: whether gains and offsets of the predicted columns are fitted to these rows.
    """
    seen, measured, _ = paths(twin, recording, rows)
    if favour:
        ground = np.concatenate([seen, np.ones((len(seen), 1))], axis=1)
        seen = ground @ np.linalg.lstsq(ground, measured, rcond=None)[0]
    return root_mean(((measured - seen) ** 2).sum(axis=1))


def paths(twin: Twin, recording: Recording, rows: slice) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Headline columns (n, k) predicted and measured in some rows, and their names; see `error_of`."""
    data = read(recording, twin)
    seen, measured = predict(twin, data)[0][rows], data.measured[rows, : data.counted]
    return seen, measured, tuple(data.columns[: data.counted])


def not_as_asked(
    twin: Twin,
    recording: Recording,
    rows: slice,
    usual: Mapping[str, float],
    asked: Mapping[str, float],
    ask_below: float,
) -> str:
    """What the finger looks like instead of what was asked for, a sentence; empty where it agrees.

    A twin that was not fitted to such a change does not decide.

    Args:
        twin: fitted to what came before.
        recording: with all that came before these rows.
        rows: of the program for which a hand was asked.
        usual: conditions without a hand.
        asked: conditions asked for.
        ask_below: error up to which nothing is wrong.
    """
    told = error_of(twin, recording, rows)
    if told <= ask_below:
        return ""
    others: dict[str, dict[str, float]] = {}
    if "gravity" in twin.effects and any(usual.get(g) != asked.get(g) for g in GRAVITY):
        others["the base had not been turned"] = {g: usual[g] for g in GRAVITY}
    weight = asked.get("payload_g", 0.0)
    if "payload" in twin.effects and weight:
        others |= {f"{s * weight:.0f} g hung at its tip": {"payload_g": s * weight} for s in SHARES}
    errors = {}
    for text, columns in others.items():
        samples = recording.samples.copy()
        for name, value in columns.items():
            samples.loc[samples.index[rows], name] = value
        errors[text] = error_of(twin, replace(recording, samples=samples), rows)
    best = min(errors, key=lambda k: errors[k], default="")
    return f"The finger moved as if {best}." if best and errors[best] < CLEARLY * told else ""
