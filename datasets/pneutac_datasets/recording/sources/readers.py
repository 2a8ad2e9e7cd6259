"""Motion capture (OptiTrack, Vicon), ROS 2 bags, `.mat` and `.npz`: markers and logs, each on its clock."""

import csv
import dataclasses
import difflib
import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pneutac_datasets.recording.recording import MAX_CELLS, Recording, count_left_out
from pneutac_datasets.recording.sources.columns import EXAMPLES, read_name
from pneutac_datasets.recording.text_table import MAX_CSV_BYTES, MAX_ROWS, TextTable
from pneutac_datasets.recording.units import UNITS
from pneutac_datasets.recording.wording import cut, listed, plural
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import refuse_pointer


@dataclass(frozen=True)
class Track:
    """A marker, or a body of several, over time."""

    time_s: np.ndarray  # (n,) rising
    position_mm: np.ndarray  # (n, 3) in the frame of the measuring system; NaN where it was not seen
    rotation: np.ndarray | None = None  # (n, 3, 3) of a body in that frame, or None of a single marker

    @classmethod
    def of(cls, time_s: np.ndarray, position_mm: np.ndarray, turns: np.ndarray) -> "Track":
        """With rotations where `turns` (n, k) are quaternions x, y, z, w; NaN where those are."""
        if turns.shape[1] != 4:
            return cls(time_s, position_mm)
        R = np.full((len(turns), 3, 3), np.nan)
        seen = np.isfinite(turns).all(1) & (np.linalg.norm(turns, axis=1) > 0.5)
        if seen.any():
            R[seen] = Rotation.from_quat(turns[seen]).as_matrix()
        return cls(time_s, position_mm, R)


@dataclass
class Source:
    """What a file holds."""

    file: Path  # for messages
    tracks: dict[str, Track] = field(default_factory=dict)  # by name
    # numbers over time by name: times (n,) in s and values (n,)
    columns: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def track(self, name: str, option: str) -> Track:
        """A track; raises InputError with the names that there are, and the nearest."""
        if name not in self.tracks:
            raise InputError(
                f"{self.file} has no marker '{name}'{_near(name, self.tracks)}; give --{option}."
            )
        return self.tracks[name]

    def need(self, names: Iterable[str]) -> None:
        """Raises InputError where one of these columns is missing."""
        if missing := [n for n in names if n not in self.columns]:
            raise InputError(f"{self.file} has no '{missing[0]}'{_near(missing[0], self.columns)}.")

    def recording(self, names: dict[str, str], meta: dict) -> Recording:
        """A recording of columns alone, on the times of the first; commands hold, the rest is interpolated.

        `names`: name in the file to column of the recording. Raises InputError where one is missing.
        """
        self.need(names)
        times = self.columns[next(iter(names))][0]
        table = {"trial": 0, "time_s": times}
        table |= {column: resampled(*self.columns[name], times, column) for name, column in names.items()}
        device = "finger" if COMMAND in table else "arm"
        return Recording(Path(), meta, pd.DataFrame(table), device)


def resampled(time_s: np.ndarray, values: np.ndarray, at_s: np.ndarray, column: str) -> np.ndarray:
    """Values (n,) of a column at other times (m,); what is commanded or counted holds until the next.

    Raises InputError: the times go back.
    """
    if np.array_equal(time_s, at_s):  # a clock may start again with each trial
        return values
    if (np.diff(time_s) < 0).any():
        raise InputError(f"The times of '{column}' go back; give a log with one clock that rises throughout.")
    if column == "trial" or "_cmd_" in column or values.dtype.kind not in "fiu":
        return values[np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(values) - 1)]
    return np.interp(at_s, time_s, values.astype(float))


def _near(name: str, names: Iterable[str]) -> str:
    names = list(names)
    close = difflib.get_close_matches(name, names, n=1)
    return f"; is '{close[0]}' meant?" if close else f"; it has {', '.join(names[:20]) or 'none'}"


REST_SHARE = 0.05  # of the samples: those of the least pressure, at which the tip rests
LEAST_MOVE_MM = 2.0  # that the tip must move to find the bending plane
SIGNS = ("", 1), ("+", 1), ("-", -1)
AXES = {f"{sign}{a}": s * np.eye(3)[i] for i, a in enumerate("xyz") for sign, s in SIGNS}


@dataclass(frozen=True)
class BaseFrame:
    """The base frame as seen by the measuring system."""

    rotation: np.ndarray  # (3, 3), its columns the base's axes
    origin_mm: np.ndarray  # (3,)

    def of(self, position_mm: np.ndarray) -> np.ndarray:
        """Positions (n, 3) in the base frame, mm."""
        return (position_mm - self.origin_mm) @ self.rotation


def axes_of(x: str, z: str) -> np.ndarray:
    """Axes of the base (3, 3), its columns, in a frame of which `x` and `z` name axes, such as `-y`.

    Raises InputError: they are none, or not at right angles.
    """
    if x not in AXES or z not in AXES or AXES[x] @ AXES[z] != 0:
        raise InputError(f"base_x is '{x}' and base_z '{z}'; give two different ones of x, y, z, -x, -y, -z.")
    return np.stack([AXES[x], np.cross(AXES[z], AXES[x]), AXES[z]], 1)


def of_body(base: Track, x: str, z: str, offset_mm: np.ndarray) -> BaseFrame:
    """The base frame of a tracked body that stands still at the base.

    `x` and `z` are axes of the body along the straight finger and in the bending direction, such as `-y`; the
    offset goes from its origin to the finger's base, in the base frame. Raises InputError where they are
    none, or not at right angles, or the body is never seen.
    """
    axes = axes_of(x, z)
    assert base.rotation is not None
    seen = np.isfinite(base.position_mm).all(1) & np.isfinite(base.rotation).all((1, 2))
    if not seen.any():
        raise InputError("The base body is never seen; choose another --base.")
    rotation = Rotation.from_matrix(base.rotation[seen]).mean().as_matrix() @ axes
    return BaseFrame(rotation, np.median(base.position_mm[seen], 0) + rotation @ offset_mm)


def of_motion(base_mm: np.ndarray, tip_mm: np.ndarray, pressure_kpa: np.ndarray) -> BaseFrame:
    """The base frame where the base has a marker only: x to where the tip rests, z the way that it bends.

    Of places of the base's marker (3,) and the tip (n, 3), and commanded pressures (n,). Raises InputError
    where the tip hardly moves, or is never seen.
    """
    seen = np.isfinite(tip_mm).all(1)
    tip, kpa = tip_mm[seen], np.abs(pressure_kpa[seen])
    if not len(tip):
        raise InputError("The tip is never seen; choose another --tip.")
    rest = np.median(tip[kpa <= np.quantile(kpa, REST_SHARE)], 0)
    x = (rest - base_mm) / np.linalg.norm(rest - base_mm)
    away = tip - rest
    across = away - np.outer(away @ x, x)
    if np.linalg.norm(across, axis=1).max() < LEAST_MOVE_MM:
        raise InputError(
            f"The tip moves less than {LEAST_MOVE_MM:g} mm, too little to find the bending direction."
        )
    z = np.linalg.svd(across, full_matrices=False)[2][0]
    z = (z - (z @ x) * x) / np.linalg.norm(z - (z @ x) * x)
    # Positive pressure bends towards +z.
    z *= np.sign((across @ z) @ (pressure_kpa[seen])) or 1.0
    return BaseFrame(np.stack([x, np.cross(z, x), z], 1), base_mm)


COMMAND = "pressure_cmd_kpa"
LEAST_ROWS = 20
LEAST_SHARE = 0.9  # of markers and log that both run, below which it is reported


def shifted(log: Source, offset_s: float) -> Source:
    """The log on the clock of the markers, of which its zero is `offset_s`."""
    columns = {name: (times + offset_s, values) for name, (times, values) in log.columns.items()}
    return dataclasses.replace(log, columns=columns)


def commanded(tip: Track, log: Source, columns: dict[str, str]) -> np.ndarray:
    """Commanded pressures (n,), kPa, at the times of a track; raises InputError where the log has none."""
    name = next((n for n, column in columns.items() if column == COMMAND), None)
    if name is None or name not in log.columns:
        raise InputError(
            f"{log.file} has no column for {COMMAND}; it has {', '.join(log.columns)}. Name it by"
            f" --columns='NAME: {COMMAND} [kPa]'."
        )
    return resampled(*log.columns[name], tip.time_s, COMMAND)


def joined(tip: Track, frame: BaseFrame, log: Source, columns: dict[str, str], length_mm: float) -> Recording:
    """A recording with a row for each time at which the tip was seen while the log, on the same clock, ran.

    `columns`: name in the log to column of the recording. Raises InputError where the two hardly overlap, or
    the log lacks a column.
    """
    log.need(columns)
    begin = max(log.columns[n][0][0] for n in columns)
    end = min(log.columns[n][0][-1] for n in columns)
    ran = (tip.time_s >= begin) & (tip.time_s <= end)
    seen = np.isfinite(tip.position_mm).all(1) & ran
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
    if lost := int((ran & ~seen).sum()):
        note = f"{plural(lost, 'frame')} in which the tip was not seen left out."
        missing = count_left_out(np.zeros(int(ran.sum())), tip.time_s[ran], seen[ran])
        recording.meta["conversion"] = {"notes": [note], "rows_left_out": missing}
    lasted_s = {"the markers": tip.time_s[-1] - tip.time_s[0], f"{log.file}": end - begin}
    used = at[-1] - at[0]
    if used < LEAST_SHARE * max(lasted_s.values()):
        lasted = " and ".join(f"{name} {seconds:.3g} s" for name, seconds in lasted_s.items())
        recording.warnings.append(
            f"{used:.3g} s are used, in which both ran: {lasted}. If that is too little, give --offset_s, or"
            " export a film at the rate at which it was taken."
        )
    return recording


SECTIONS = ("trajectories", "objects", "segments")
# Where messages have a position, and their orientation.
PLACES = {
    "pose.position": "pose.orientation",
    "pose.pose.position": "pose.pose.orientation",
    "position": "orientation",
    "transform.translation": "transform.rotation",
    "point": "",
}


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
            of_name = found.setdefault(name_row[column].strip(), {})
            of_name.setdefault(f"{kinds[column]} {axes[column]}", column)
    source = Source(file)
    for name, columns in found.items():
        places = [columns[f"position {a}"] for a in "xyz" if f"position {a}" in columns]
        turns = [columns[f"rotation {a}"] for a in "xyzw" if f"rotation {a}" in columns]
        if len(places) == 3:
            source.tracks[name] = Track.of(table[:, 1], scale * table[:, places], table[:, turns])
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
        section = rows[at][0].strip()
        if len(rows) < at + 6:
            raise InputError(f"{file} ends within the section '{section}'; export it again.")
        rate = pd.to_numeric(pd.Series(rows[at + 1][:1], dtype=object), errors="coerce").max()
        if not rate > 0:
            raise InputError(f"{file}: the line below '{section}' must be the rate in Hz.")
        names, axes, units = rows[at + 2 : at + 5]
        axes = [a.strip().upper() for a in axes]
        end = next((i for i in range(at + 5, len(rows)) if not any(c.strip() for c in rows[i])), len(rows))
        table = _numbers(rows[at + 5 : end], len(axes))
        labels = [(c, label.strip()) for c, label in enumerate(names) if label.strip()]
        ends = [*(column for column, _ in labels[1:]), len(axes)]
        for (column, label), last in zip(labels, ends, strict=False) if len(table) else ():
            here = {a: c for c, a in enumerate(axes[column:last], column)}
            place = [here[a] for a in ("TX", "TY", "TZ") if a in here] or [
                here[a] for a in "XYZ" if a in here
            ]
            if len(place) != 3:
                continue
            unit = units[place[0]].strip().lower() if place[0] < len(units) else ""
            turns = [here[a] for a in ("RX", "RY", "RZ", "RW") if a in here]  # of three the order is unknown
            moved = _scale(file, unit or "mm") * table[:, place], table[:, turns]
            time_s = (table[:, 0] - table[0, 0]) / rate
            source.tracks[label.split(":")[-1]] = Track.of(time_s, *moved)
    if not source.tracks:
        raise InputError(
            f"{file} has no markers in a section {' or '.join(s.capitalize() for s in SECTIONS)}; export"
            " trajectories from Nexus as ASCII, or objects from Tracker as CSV."
        )
    return source


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
    if unit not in UNITS["length"]:
        raise InputError(
            f"{file}: the length unit '{unit}' is none of {EXAMPLES['length']}; export in one of them."
        )
    return UNITS["length"][unit]


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
    topics: dict[str, list[dict[str, float]]] = {}
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, logged_ns, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                stamp = getattr(getattr(message, "header", None), "stamp", None)
                seconds = 0.0 if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
                found = {"": seconds if seconds > 0 else logged_ns * 1e-9}  # a header may never be set
                _flatten("", message, found)
                topics.setdefault(connection.topic, []).append(found)
    except (AnyReaderError, OSError, ValueError, KeyError) as e:
        raise InputError(f"{folder} is no ROS 2 bag that rosbags reads ({e}).") from e
    source, begin = Source(folder), min((messages[0][""] for messages in topics.values()), default=0.0)
    for topic, messages in topics.items():
        table = pd.DataFrame(messages).sort_values("", kind="stable")
        at = table.pop("").to_numpy() - begin
        source.columns |= {f"{topic}.{name}": (at, table[name].to_numpy()) for name in table}
        for place, turn in PLACES.items():
            if all(f"{place}.{a}" in table for a in "xyz"):
                turns = [f"{turn}.{a}" for a in "xyzw" if f"{turn}.{a}" in table]
                position_m = table[[f"{place}.{a}" for a in "xyz"]].to_numpy()
                source.tracks[topic] = Track.of(at, 1e3 * position_m, table[turns].to_numpy())
                break
    return source


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
    return _arrays_table(file, flat, time, "MATLAB")


def npz_table(file: Path, time: str = "") -> TextTable:
    """Every vector of an `.npz` that is as long as its times, texts too; matrices as in `mat_table`."""
    refuse_pointer(file)
    flat: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(file) as packed:
            size = sum(entry.file_size for entry in packed.infolist())
        if size > 8 * MAX_CELLS:
            raise InputError(f"{file} holds {size / 2**30:.1f} GB; keep every n-th row.")
        with np.load(file, allow_pickle=False) as content:
            for name in content.files:
                value = np.squeeze(content[name])
                if value.dtype.kind in "fiubcU" and value.ndim in (1, 2):
                    flat[name] = value
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as e:
        reason = cut(" ".join(str(e).split()) or type(e).__name__)
        raise InputError(
            f"{file} is no .npz of arrays ({reason}); save it by `numpy.savez`, without objects."
        ) from e
    return _arrays_table(file, flat, time, "NumPy")


def _arrays_table(file: Path, flat: dict[str, np.ndarray], time: str, style: str) -> TextTable:
    """The table of named arrays of one and two dimensions; see `mat_table`."""
    vectors = [n for n, v in flat.items() if v.ndim == 1 and len(v) > 1]
    if not time:
        clocks = [n for n in vectors if n == TIME] or [
            n for n in vectors if read_name(n.rpartition(".")[2]).kind == "time"
        ]
        time = clocks[0] if len(clocks) == 1 else TIME
    matrices = {n: v if len(v) >= v.shape[1] else v.T for n, v in flat.items() if v.ndim == 2}
    within = {f"{n}_{i + 1}": x for n, v in matrices.items() for i, x in enumerate(v.T)}
    clock = flat.pop(time, within.get(time, np.zeros(())))
    if clock.ndim != 1 or clock.dtype.kind not in "fiub":
        has = listed(f"{shown(n)} {'x'.join(map(str, v.shape))}" for n, v in flat.items()) or "no arrays"
        column = next((f", such as {n}_1 for the first column of {shown(n)}" for n in matrices), "")
        raise InputError(
            f"{file} has no vector '{time}' of times; it has {has}. Give its name by --time of"
            f" `pneutac convert`{column}."
        )
    count = len(clock)
    # nanoseconds since 1970 have more digits than a float
    columns, notes = {time: clock if clock.dtype.kind in "iu" else clock.astype(float)}, []
    for name, value in flat.items():
        if value.size > MAX_CELLS:
            raise InputError(f"{file}: '{name}' has {value.size} entries; keep every n-th.")
        if value.ndim == 2 and value.shape[0] != count == value.shape[1]:
            value = value.T
        if value.shape[:1] != (count,) or value.dtype.kind not in "fiubU":
            if value.size > 1:
                what = "complex" if value.dtype.kind == "c" else "x".join(map(str, value.shape))
                notes.append(f"{file}: {shown(name)} ({what}) is left out; '{time}' has {count} entries.")
            continue
        if value.ndim == 1:
            columns[name] = value.astype(object if value.dtype.kind == "U" else float)
        elif value.ndim == 2 and value.dtype.kind != "U":
            columns |= {f"{name}_{i + 1}": column.astype(float) for i, column in enumerate(value.T)}
    return TextTable(file, pd.DataFrame(columns), {}, np.arange(count) + 1, style, notes)


def _flatten_mat(name: str, value, into: dict[str, np.ndarray]) -> None:
    """Numeric arrays of a value by name; other kinds are left out."""
    if hasattr(value, "_fieldnames"):
        for entry in value._fieldnames:
            _flatten_mat(f"{name}.{entry}", getattr(value, entry), into)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiubc" and value.ndim in (1, 2):
        into[name] = value
