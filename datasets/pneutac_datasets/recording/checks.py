"""Looks at a recording before any model does: faults of tracker, sensors, clock and experiment."""

import numpy as np

from pneutac_datasets.recording import gauges, loops, poses, tracker
from pneutac_datasets.recording.finding import Finding
from pneutac_datasets.recording.recording import Recording

LOOKS = (
    tracker.jumps,
    tracker.frozen,
    tracker.stale,
    gauges.saturated,
    gauges.ceiling,
    gauges.clipped_command,
    gauges.coarse,
    gauges.repeated,
    gauges.other_unit,
    loops.clock,
    loops.closed_loop,
    loops.late_command,
    poses.exchanged_axes,
    poses.drift,
)


def check(recording: Recording) -> tuple[Recording, list[str]]:
    """Finds faults and undoes those that are certain.

    Returns:
        The recording without rows where the tracker jumped away and came back or stood still, and with angles
        that do not wrap; and one plain sentence for each finding (the loader's warnings first).
    """
    found = findings(recording)
    clean = poses.unwrap(recording)[0] if recording.device != "gel" else recording
    keep = np.ones(len(recording), bool)
    for f in found:
        if f.kind == "frozen" or (f.kind == "jumps" and not f.numbers["kept"]):
            keep[f.rows] = False
    clean = clean if keep.all() else clean.keep(keep)
    return clean, [*recording.warnings, *(f.sentence for f in found)]


def findings(recording: Recording) -> list[Finding]:
    """All that is found, also for programs: a search may take them as hypotheses.

    Rows count those of this recording. A gel's is looked at where its images are read.
    """
    if recording.device == "gel":
        return []
    recording, found = poses.unwrap(recording)
    for look in LOOKS:
        found += look(recording)
    if not any(recording.has(c.replace("cmd_", "")) for c in recording.pressure_columns):
        text = (
            "There is no measured pressure, so a slow valve and a creeping body look alike; log pressure_kpa."
        )
        found.append(Finding("no_measured_pressure", text, tuple(recording.pressure_columns)))
    return found
