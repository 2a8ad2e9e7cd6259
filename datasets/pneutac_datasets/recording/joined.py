"""Several recordings of one device as one."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError


def joined(recordings: Sequence[Recording], pauses_s: Sequence[float | None]) -> Recording:
    """All trials of all recordings in their order, renumbered.

    Args:
        recordings: of one device, with the same columns.
        pauses_s: seconds without pressure before each recording, since the one before it; None where its
            first trial begins as its own `recording.json` says, or at an unknown state.

    Raises:
        InputError: they differ in device, length or columns.
    """
    first = recordings[0]
    columns = set(first.samples)
    tables, trials, count = [], {}, 0
    for r, pause_s in zip(recordings, pauses_s, strict=True):
        if r.device != first.device or r.length_mm != first.length_mm:
            raise InputError(f"{r.folder} is not of the device of {first.folder}.")
        if set(r.samples) != columns:
            other = ", ".join(sorted(set(r.samples) ^ columns))
            raise InputError(f"{r.folder} and {first.folder} differ in {other}; record the same columns.")
        stated = r.meta.get("trials") or {}
        names = {old: count + i for i, old in enumerate(r.trials())}
        tables.append(r.samples.assign(trial=r.samples["trial"].map(names)))
        trials |= {str(new): stated[str(old)] for old, new in names.items() if str(old) in stated}
        if pause_s is not None and count:
            trials[str(count)] = {"start": "continues", "pause_s": round(pause_s, 3)}
        count += len(names)
    samples = pd.concat(tables, ignore_index=True)[list(first.samples)]
    return replace(first, samples=samples, meta=first.meta | {"trials": trials}, warnings=[])
