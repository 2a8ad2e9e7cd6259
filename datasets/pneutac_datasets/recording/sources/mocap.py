"""CSV of motion capture: OptiTrack's Motive and Vicon's Nexus."""

import csv
from pathlib import Path

import numpy as np

from pneutac_datasets.recording.sources.tracks import Source, Track, rotations
from pneutac_datasets.recording.text_table import MAX_CSV_BYTES, MAX_ROWS
from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer

SECTIONS = ("trajectories", "objects", "segments")
MM = {"meters": 1000.0, "centimeters": 10.0, "millimeters": 1.0, "m": 1000.0, "cm": 10.0, "mm": 1.0}


def read_optitrack(file: Path) -> Source:
    """A take that Motive exported as CSV (tracking data): its bodies and markers.

    The first line holds pairs, `Length Units` among them; four lines of headers name each column's object
    and its kind; times are seconds since the take began.

    Raises:
        InputError: the file is none, its unit is unknown, or its orientations are no quaternions.
    """
    rows = _rows(file)
    first = rows[0]
    facts = {k.strip().lower(): v.strip().lower() for k, v in zip(first[::2], first[1::2], strict=False)}
    scale = _scale(file, facts.get("length units", "meters"))
    at = next((i for i, row in enumerate(rows) if row and row[0].strip().lower() == "frame"), None)
    if at is None or at < 4:
        raise InputError(f"{file} has no line that begins with 'Frame'; export tracking data from Motive.")
    axes, kinds = [c.strip().lower() for c in rows[at]], [c.strip().lower() for c in rows[at - 1]]
    name_row = next((r for r in rows[1:at] if len(r) > 1 and r[1].strip().lower() == "name"), rows[at - 3])
    table = _numbers(rows[at + 1 :], len(axes))
    if facts.get("rotation type", "quaternion") != "quaternion" and "rotation" in kinds:
        raise InputError(f"{file} has rotations as {facts['rotation type']}; export them as quaternions.")
    found: dict[str, dict[str, int]] = {}
    for column in range(2, len(axes)):
        if kinds[column] in ("position", "rotation"):
            name = name_row[column].strip()
            found.setdefault(name, {}).setdefault(f"{kinds[column]} {axes[column]}", column)
    source, time_s = Source(file), table[:, 1]
    for name, columns in found.items():
        places = [columns[f"position {a}"] for a in "xyz" if f"position {a}" in columns]
        turns = [columns[f"rotation {a}"] for a in "xyzw" if f"rotation {a}" in columns]
        if len(places) < 3:
            continue
        R = rotations(table[:, turns]) if len(turns) == 4 else None
        source.tracks[name] = Track(time_s, scale * table[:, places], R)
    return source


def read_vicon(file: Path) -> Source:
    """What Nexus or Tracker exported as CSV: markers of `Trajectories`, bodies of `Objects` or `Segments`.

    Each section has its rate in Hz, a line of names (`Subject:Marker` above the first column of each), one of
    axes (X, Y, Z; of bodies RX, RY, RZ, perhaps RW, TX, TY, TZ), one of units. Bodies have orientations where
    these are quaternions.

    Raises:
        InputError: the file has no such section, or a unit is unknown.
    """
    rows = _rows(file)
    source = Source(file)
    for at in (i for i, row in enumerate(rows) if row and row[0].strip().lower() in SECTIONS):
        _vicon_section(file, rows, at, source)
    if not source.tracks:
        raise InputError(
            f"{file} has no markers in a section {' or '.join(s.capitalize() for s in SECTIONS)}; export"
            " trajectories from Nexus as ASCII, or objects from Tracker as CSV."
        )
    return source


def _vicon_section(file: Path, rows: list[list[str]], at: int, source: Source) -> None:
    """Adds the markers or bodies of one section."""
    if len(rows) < at + 6:
        raise InputError(f"{file} ends within the section '{rows[at][0].strip()}'; export it again.")
    try:
        rate = float(rows[at + 1][0])
    except (ValueError, IndexError):
        rate = 0.0
    if not rate > 0:
        raise InputError(f"{file}: the line below '{rows[at][0].strip()}' must be the rate in Hz.")
    names, axes, units = rows[at + 2 : at + 5]
    axes = [a.strip().upper() for a in axes]
    end = next((i for i in range(at + 5, len(rows)) if not any(c.strip() for c in rows[i])), len(rows))
    table = _numbers(rows[at + 5 : end], len(axes))
    if not len(table):
        return
    time_s = (table[:, 0] - table[0, 0]) / rate
    labels = [(c, label.strip()) for c, label in enumerate(names) if label.strip()]
    for k, (column, label) in enumerate(labels):
        last = labels[k + 1][0] if k + 1 < len(labels) else len(axes)
        here = {a: c for c, a in enumerate(axes[column:last], column)}
        place = [here[a] for a in ("TX", "TY", "TZ") if a in here] or [here[a] for a in "XYZ" if a in here]
        if len(place) != 3:
            continue
        unit = units[place[0]].strip().lower() if place[0] < len(units) else ""
        turns = [here[a] for a in ("RX", "RY", "RZ", "RW") if a in here]
        R = rotations(table[:, turns]) if len(turns) == 4 else None  # three angles are of an unknown order
        name = label.split(":")[-1]
        source.tracks[name] = Track(time_s, _scale(file, unit or "mm") * table[:, place], R)


def is_optitrack(file: Path) -> bool:
    """Whether a CSV begins as Motive's do."""
    return _begin(file).startswith("format version")


def is_vicon(file: Path) -> bool:
    """Whether a CSV has one of Vicon's sections."""
    return any(line.split(",")[0].strip() in SECTIONS for line in _begin(file).splitlines())


def _begin(file: Path) -> str:
    refuse_pointer(file)
    with file.open(encoding="utf-8-sig", errors="replace") as f:
        return f.read(2**16).lower()


def _rows(file: Path) -> list[list[str]]:
    if file.stat().st_size > MAX_CSV_BYTES:
        raise InputError(f"{file} is above {MAX_CSV_BYTES // 2**20} MB; export fewer frames or markers.")
    try:
        with file.open(encoding="utf-8-sig", newline="") as f:
            rows = list(csv.reader(f))
    except (UnicodeError, csv.Error) as e:
        raise InputError(f"{file} is no CSV text ({e}); export it again.") from e
    if not rows or len(rows) > MAX_ROWS:
        raise InputError(f"{file} has {len(rows)} lines; export one to {MAX_ROWS} of them.")
    return rows


def _numbers(rows: list[list[str]], width: int) -> np.ndarray:
    """Numbers (n, width) of the rows; NaN where a cell is empty or no number."""
    table = np.full((len(rows), width), np.nan)
    for i, row in enumerate(rows):
        for j, cell in enumerate(row[:width]):
            try:
                table[i, j] = float(cell)
            except ValueError:
                continue  # a marker that was not seen leaves its cells empty
    return table[np.isfinite(table[:, 0])]


def _scale(file: Path, unit: str) -> float:
    if unit not in MM:
        raise InputError(
            f"{file}: the length unit '{unit}' is none of {', '.join(MM)}; export in one of them."
        )
    return MM[unit]
