"""Markers and a log of pressures, each on its clock, as one bench recording."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources.frame import BaseFrame
from pneutac_datasets.recording.sources.tracks import Source, Track, resampled
from pneutac_sim.errors import InputError

COMMAND = "pressure_cmd_kpa"
LEAST_ROWS = 20
LEAST_SHARE = 0.9  # of markers and log that both run, below which it is reported


def shifted(log: Source, offset_s: float) -> Source:
    """The log on the clock of the markers, of which its zero is `offset_s`."""
    columns = {name: (times + offset_s, values) for name, (times, values) in log.columns.items()}
    return dataclasses.replace(log, columns=columns)


def command(tip: Track, log: Source, columns: dict[str, str]) -> np.ndarray:
    """Commanded pressures (n,), kPa, at the times of a track.

    Raises:
        InputError: the log has none.
    """
    name = next((n for n, column in columns.items() if column == COMMAND), None)
    if name is None or name not in log.columns:
        raise InputError(
            f"{log.file} has no column for {COMMAND}; it has {', '.join(log.columns)}. Name it by"
            f" --columns='NAME: {COMMAND} [kPa]'."
        )
    return resampled(*log.columns[name], tip.time_s, COMMAND)


def joined(tip: Track, frame: BaseFrame, log: Source, columns: dict[str, str], length_mm: float) -> Recording:
    """A recording with a row for each time at which the tip was seen while the log ran.

    Args:
        tip: of the finger's tip.
        frame: of the finger's base.
        log: numbers on the same clock.
        columns: name in the log to column of the recording.
        length_mm: of the straight finger.

    Raises:
        InputError: the two hardly overlap, or the log lacks a column.
    """
    missing = [n for n in columns if n not in log.columns]
    if missing:
        raise InputError(f"{log.file} has no '{missing[0]}'; it has {', '.join(log.columns)}.")
    begin = max(log.columns[n][0][0] for n in columns)
    end = min(log.columns[n][0][-1] for n in columns)
    seen = np.isfinite(tip.position_mm).all(1) & (tip.time_s >= begin) & (tip.time_s <= end)
    if seen.sum() < LEAST_ROWS:
        raise InputError(
            f"The tip is seen in {seen.sum()} frames while {log.file} runs ({begin:.4g} to {end:.4g} s on the"
            f" markers' clock, which runs {tip.time_s[0]:.4g} to {tip.time_s[-1]:.4g} s); give --offset_s."
        )
    at = tip.time_s[seen]
    table = {"trial": np.zeros(len(at), int), "time_s": at - at[0]}
    table |= {column: resampled(*log.columns[name], at, column) for name, column in columns.items()}
    place = frame.of(tip.position_mm[seen])
    table |= {f"tip_{a}_mm": place[:, i] for i, a in enumerate("xyz")}
    recording = Recording(Path(), {"length_mm": length_mm}, pd.DataFrame(table), "finger")
    ran = {"the markers": tip.time_s[-1] - tip.time_s[0], f"{log.file}": end - begin}
    used = at[-1] - at[0]
    if used < LEAST_SHARE * max(ran.values()):
        lasted = " and ".join(f"{name} {seconds:.3g} s" for name, seconds in ran.items())
        recording.warnings.append(
            f"{used:.3g} s are used, in which both ran: {lasted}. If that is too little, give --offset_s, or"
            " export a film at the rate at which it was taken."
        )
    return recording


def tabled(table: pd.DataFrame, meta: dict) -> Recording:
    """A recording of columns alone, where the file has all of it."""
    if "trial" not in table:
        table.insert(0, "trial", 0)
    device = "finger" if "pressure_cmd_kpa" in table else "arm"
    return Recording(Path(), meta, table, device)
