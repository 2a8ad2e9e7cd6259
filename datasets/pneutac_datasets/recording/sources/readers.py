"""Readers of motion capture (OptiTrack's Motive, Vicon's Nexus), ROS 2 bags and MATLAB's `.mat` files."""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pneutac_datasets.recording.reading import MAX_CELLS
from pneutac_datasets.recording.sources.columns import read_name
from pneutac_datasets.recording.sources.frame import Source, Track, rotations
from pneutac_datasets.recording.text_table import MAX_CSV_BYTES, MAX_ROWS, TextTable
from pneutac_datasets.recording.wording import cut, listed
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import refuse_pointer

SECTIONS = ("trajectories", "objects", "segments")
MM = {"meters": 1000.0, "centimeters": 10.0, "millimeters": 1.0, "m": 1000.0, "cm": 10.0, "mm": 1.0}


def read_optitrack(file: Path) -> Source:
    """A take that Motive exported as CSV (tracking data): its bodies and markers.

    The first line holds pairs, `Length Units` among them; four lines of headers name each column's object and
    its kind; times are seconds since the take began. Raises InputError where the file is none, its unit is
    unknown, or its orientations are no quaternions.
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
    these are quaternions. Raises InputError where the file has no such section, or a unit is unknown.
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
    cells = pd.DataFrame([(row + [""] * width)[:width] for row in rows], dtype=object)
    table = cells.apply(pd.to_numeric, errors="coerce").to_numpy(float)  # an unseen marker's cells are empty
    return table[np.isfinite(table[:, 0])]


def _scale(file: Path, unit: str) -> float:
    if unit not in MM:
        raise InputError(
            f"{file}: the length unit '{unit}' is none of {', '.join(MM)}; export in one of them."
        )
    return MM[unit]


MM_A_M = 1000.0  # ROS counts in metres


def read_rosbag(folder: Path) -> Source:
    """Poses and numbers of every topic of a bag (folder or .mcap), on the times of its messages' headers.

    A message with a position, also inside `pose`, `pose.pose`, `transform` or `point`, is a marker by its
    topic's name. Every number of any message is a column `topic.field`, such as `/valve/command.data`; times
    begin with the bag's first message. Messages without a header have the time at which they were logged.
    Raises InputError where rosbags is not installed, or the bag cannot be read.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as e:
        raise InputError("A ROS 2 bag needs rosbags: uv pip install -e '.[ros]' in PneuTac's folder.") from e
    times: dict[str, list[float]] = {}
    numbers: dict[str, dict[str, list[float]]] = {}
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, logged_ns, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                found: dict[str, float] = {}
                _flatten("", message, found)
                stamp = _stamp(message)
                times.setdefault(connection.topic, []).append(logged_ns * 1e-9 if stamp is None else stamp)
                into = numbers.setdefault(connection.topic, {k: [] for k in found})
                for name in into:
                    into[name].append(found.get(name, np.nan))
    except (AnyReaderError, OSError, ValueError, KeyError) as e:
        raise InputError(f"{folder} is no ROS 2 bag that rosbags reads ({e}).") from e
    source, begin = Source(folder), min((t[0] for t in times.values()), default=0.0)
    for topic, fields in numbers.items():
        at = np.array(times[topic]) - begin
        order = np.argsort(at, kind="stable")
        columns = {name: np.array(values)[order] for name, values in fields.items()}
        source.columns |= {f"{topic}.{name}": (at[order], values) for name, values in columns.items()}
        track = _track(at[order], columns)
        if track is not None:
            source.tracks[topic] = track
    return source


def _track(time_s: np.ndarray, columns: dict[str, np.ndarray]) -> Track | None:
    for place, turn in (
        ("pose.position", "pose.orientation"),
        ("pose.pose.position", "pose.pose.orientation"),
        ("position", "orientation"),
        ("transform.translation", "transform.rotation"),
        ("point", ""),
    ):
        if all(f"{place}.{a}" in columns for a in "xyz"):
            position = np.stack([columns[f"{place}.{a}"] for a in "xyz"], 1) * MM_A_M
            turns = [columns[f"{turn}.{a}"] for a in "xyzw" if f"{turn}.{a}" in columns]
            R = rotations(np.stack(turns, 1)) if len(turns) == 4 else None
            return Track(time_s, position, R)
    return None


def _flatten(name: str, value: Any, into: dict[str, float]) -> None:
    """Numbers of a message by the path of their field; arrays of up to 16 entries by their index."""
    if isinstance(value, bool | int | float | np.integer | np.floating):
        into[name] = float(value)
    elif isinstance(value, np.ndarray | list | tuple) and len(value) <= 16:
        for i, entry in enumerate(value):
            _flatten(f"{name}.{i}", entry, into)
    elif dataclasses.is_dataclass(value):
        for entry in (f.name for f in dataclasses.fields(value) if not f.name.startswith("__")):
            _flatten(f"{name}.{entry}" if name else entry, getattr(value, entry), into)


def _stamp(message: Any) -> float | None:
    """Time of a message's header, s; None where it has none or it was never set."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = 0.0 if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
    return seconds if seconds > 0 else None


TIME = "time_s"


def mat_table(file: Path, time: str = "") -> TextTable:
    """Every numeric vector of a `.mat` file, of version 7 or earlier, that is as long as its times.

    Fields of a struct are called `struct.field`. A matrix of as many rows (or columns) as there are times
    becomes one column each: `tip_1`, `tip_2` ... Without the name of the times' variable the one whose name
    says so is taken; raises InputError where there is none.
    """
    from scipy.io import loadmat

    refuse_pointer(file)
    try:
        content = loadmat(file, squeeze_me=True, struct_as_record=False)
    except NotImplementedError as e:
        raise InputError(f"{file} is of version 7.3; save it with MATLAB's option '-v7'.") from e
    except Exception as e:  # what SciPy's reader raises on damaged bytes has no common class
        reason = cut(" ".join(str(e).split()) or type(e).__name__)
        raise InputError(f"{file} is no .mat file, or is damaged ({reason}); save it again.") from e
    flat: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            _flatten_mat(name, value, flat)
    vectors = [n for n, v in flat.items() if v.ndim == 1 and len(v) > 1]
    if not time:
        clocks = [n for n in vectors if n == TIME] or [
            n for n in vectors if read_name(n.rpartition(".")[2]).kind == "time"
        ]
        time = clocks[0] if len(clocks) == 1 else TIME
    if time not in vectors or flat[time].dtype.kind not in "fiub":
        has = listed(f"{shown(n)} {'x'.join(map(str, v.shape))}" for n, v in flat.items()) or "no arrays"
        raise InputError(f"{file} has no vector '{time}' of times; it has {has}. Give its name by --time.")
    count = len(flat[time])
    columns, notes = {time: flat.pop(time).astype(float)}, []
    for name, value in flat.items():
        if value.size > MAX_CELLS:
            raise InputError(f"{file}: '{name}' has {value.size} entries; keep every n-th.")
        if value.ndim == 2 and value.shape[0] != count == value.shape[1]:
            value = value.T
        if value.shape[:1] != (count,) or value.dtype.kind not in "fiub":
            if value.size > 1:
                what = "complex" if value.dtype.kind == "c" else "x".join(map(str, value.shape))
                notes.append(f"{file}: {shown(name)} ({what}) is left out; '{time}' has {count} entries.")
            continue
        if value.ndim == 1:
            columns[name] = value.astype(float)
        elif value.ndim == 2:
            columns |= {f"{name}_{i + 1}": column.astype(float) for i, column in enumerate(value.T)}
    return TextTable(file, pd.DataFrame(columns), {}, np.arange(count) + 1, "MATLAB", notes)


def _flatten_mat(name: str, value, into: dict[str, np.ndarray]) -> None:
    """Numeric arrays of a value by name; other kinds are left out."""
    if hasattr(value, "_fieldnames"):
        for entry in value._fieldnames:
            _flatten_mat(f"{name}.{entry}", getattr(value, entry), into)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiubc" and value.ndim in (1, 2):
        into[name] = value
