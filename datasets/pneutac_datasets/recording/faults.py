"""Everything that is wrong with a recording at once, where loading it stops at the first fault."""

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from pneutac_datasets.recording import reading, rules, units
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.gel import gel_faults
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import listed
from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer


class _Collected(list):
    def __call__(self, call: Callable, *args):
        """What a call returns; None, with its sentence stored, where it refuses."""
        try:
            return call(*args)
        except InputError as e:
            if str(e) not in self:
                self.append(str(e))
            return None


def recording_faults(folder: str | Path) -> tuple[list[str], list[str]]:
    """All that keeps a bench recording, or a LeRobotDataset with its columns, from being read.

    Returns:
        One sentence for each fault; one for each note on what is poor but usable, where there is no fault.
    """
    folder, found = Path(folder), _Collected()
    meta = found(reading.read_meta, folder)
    if meta is None:
        return list(found), []
    for rule in (rules.check_names, rules.check_meta):
        found(rule, meta, folder / "recording.json")
    read = found(reading.read_table, folder, meta)
    device = found(rules.device_of, meta, pd.DataFrame() if read is None else read[0], folder)
    if read is not None and device is not None:
        _look_at(read[0], device, meta, read[1], found)
    if found:
        return list(found), []
    recording = found(Recording.load, folder)
    if recording is None:
        return list(found), []
    faults, notes = gel_faults(recording) if recording.device == "gel" else (_pictures(recording), [])
    return faults, [] if faults else [*check(recording)[1], *notes]


def _pictures(recording: Recording) -> list[str]:
    """Pictures of a body that are missing, or pointers to files; the first and last of a camera are read."""
    found = _Collected()
    for name in recording.samples:
        if not re.fullmatch(r"(image|mask)(_\w+)?", name):
            continue
        named = [v for v in recording.samples[name] if isinstance(v, str | dict) and v]
        for value in (*named[:1], *named[-1:]):
            found(recording.image, value)
        for value in named:
            if isinstance(value, str) and (recording.folder / value).is_file():
                found(refuse_pointer, recording.folder / value)
            elif isinstance(value, str):
                found(recording.image, value)
    return list(found)


def _look_at(samples: pd.DataFrame, device: str, meta: dict, file: Path, found: _Collected) -> None:
    """Every rule of the table by itself: one that is broken does not hide the next."""
    found += rules.missing_columns(samples, device, file).values()
    good, broken = {}, {}
    for name in samples.columns if len(samples) else ():
        try:
            good[name] = rules.clean_numbers(samples[[name]], device, file)[name]
        except InputError as e:  # one sentence for a row that several columns lack
            row = re.search(r"row \d+", str(e))
            broken.setdefault(row[0] if row else str(e), []).append((name, str(e)))
    for cases in broken.values():
        others = f" So are {listed(repr(n) for n, _ in cases[1:])}." if cases[1:] else ""
        found.append(cases[0][1] + others)
    table = pd.DataFrame(good)
    if "trial" in table:
        table["trial"] = found(rules.clean_trials, table["trial"], file)
    if device == "gel":
        return
    if {"trial", "time_s"} <= set(table) and table["trial"].notna().all():
        found(rules.check_time, table, file, [])
        found(rules.check_sent, table, file)
    gravity = [c for c in table if c.startswith("gravity_")]
    found += units.unit_faults(table if len(gravity) == 3 else table.drop(columns=gravity), meta, file)
