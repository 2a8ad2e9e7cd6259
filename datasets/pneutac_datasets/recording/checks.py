"""Looks at a recording before any model does: faults of tracker, sensors, clock and experiment."""

import numpy as np

from pneutac_datasets.recording import gauges, loops, poses, pressures, tracker
from pneutac_datasets.recording.finding import Finding
from pneutac_datasets.recording.recording import Recording

LOOKS = (
    tracker.jumps,
    tracker.frozen,
    tracker.stale,
    gauges.saturated,
    gauges.clipped_command,
    gauges.coarse,
    gauges.repeated,
    loops.clock,
    loops.closed_loop,
    loops.late_command,
    poses.exchanged_axes,
    poses.misplaced_tip,
    poses.other_way_round,
    poses.drift,
)


def check(recording: Recording) -> tuple[Recording, list[str]]:
    """Finds faults and undoes those that are certain.

    Returns:
        The recording without rows where the tracker jumped away and came back or stood still, with angles
        that do not wrap, and with pressures as `pressures.usable` gives them; and one plain sentence for each
        finding (the loader's warnings first).
    """
    clean, found = _looked(recording)
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
    return _looked(recording)[1]


def _looked(recording: Recording) -> tuple[Recording, list[Finding]]:
    """The recording with its angles and pressures as they may be used, and all that is found."""
    if recording.device == "gel":
        return recording, []
    measured = pressures.measured_pressures(recording)
    recording, found = poses.unwrap(recording)
    recording, more = pressures.usable(recording)
    found += more
    for look in LOOKS:
        found += look(recording)
    if not measured:
        text = (
            "There is no measured pressure, so a slow valve and a creeping body cannot be distinguished; "
            "log pressure_kpa."
        )
        found.append(Finding("no_measured_pressure", text, tuple(recording.pressure_columns)))
    return recording, found
