"""One plain table or several, of a lab's own names and units, as a bench recording next to them."""

import glob
import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from pneutac_datasets.recording import reading, rules
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources import readers
from pneutac_datasets.recording.sources.columns import LEAVE_OUT, Column, parse_columns, read_name, understand
from pneutac_datasets.recording.sources.frame import axes_of
from pneutac_datasets.recording.text_table import TextTable, read_text
from pneutac_datasets.recording.wording import SourceFile, listed, plural
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import read_fields, write_text

ENDING = ".recording"  # of the folder next to the files
MAPPING = "mapping.yaml"  # there, what the columns are
# Fields of `recording.json` that each conversion writes anew.
REWRITTEN = ("length_mm", "length_proposed", "samples", "source", "conversion")
TEXT = (".csv", ".txt", ".tsv", ".tab", ".dat", ".log", ".asc", ".prn")
FILES = (*TEXT, ".mat", ".parquet")
SPREADSHEETS = (".xlsx", ".xls", ".xlsm", ".ods", ".numbers")
TIPS = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
VECTORS = "tip_{}_mm", "force_{}_n", "gravity_{}"
REST_SHARE = 0.05  # of the rows: those of the least pressure
ALONG = 0.7  # cosine between the resting tip and x, below which the axes must be others
FROM_TIP = 0.2  # of its motion: nearer to the origin than that no resting tip is to its base
EPOCH_S = 1e8  # a clock beyond this counts since 1970


@dataclass(frozen=True)
class Given:
    """What is known of the tables beforehand; the fields of `mapping.yaml`."""

    # name in the table to column of the recording, as `Column.parsed` reads it
    columns: dict[str, str] = field(default_factory=dict)
    # position of the finger's base in the table's frame
    base_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_x: str = "x"  # axis of the table's frame along the straight finger
    base_z: str = "z"  # axis of the table's frame in the bending direction
    length_mm: float | None = None  # of the straight finger
    rate_hz: float | None = None  # rows a second, where no column is a time
    date: str = ""  # of the measurement

    @classmethod
    def load(cls, file: Path) -> "Given":
        """Of a `mapping.yaml`; raises InputError where it is none."""
        if not file.is_file():
            raise InputError(f"mapping is '{file}', which is no file; `pneutac convert` writes one.")
        content = read_fields(file, cls.__dataclass_fields__)
        given = {k: v for k, v in content.items() if v not in (None, "")}
        try:
            given |= {k: float(given[k]) for k in ("length_mm", "rate_hz") if k in given}
            given |= {k: str(given[k]) for k in ("base_x", "base_z", "date") if k in given}
            x, y, z = (float(v) for v in given.pop("base_mm", cls.base_mm))
            if not isinstance(given.get("columns", {}), dict):
                raise ValueError("columns must be names and what they are")
        except (TypeError, ValueError) as e:
            raise InputError(f"{file} is no mapping: {e}.") from e
        return cls(parse_columns(given.pop("columns", {})), (x, y, z), **given)

    def text(self, columns: Sequence[Column], length_mm: float | None) -> str:
        """The content of `mapping.yaml` once the columns are known."""
        content = {"columns": {c.name: str(c) for c in columns}, "length_mm": length_mm}
        content |= {"base_mm": list(self.base_mm), "base_x": self.base_x, "base_z": self.base_z}
        content |= {"rate_hz": self.rate_hz, "date": self.date}
        content = {k: v for k, v in content.items() if v not in (None, "")}
        head = "# What the columns of the table are; `pneutac convert` and every --mapping read it.\n"
        return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=1000)


@dataclass
class Understood:
    """Tables as a recording, and how they were understood."""

    files: list[Path]  # in the order of their trials
    recording: Recording  # not written yet
    columns: list[Column]  # what each column of the tables is
    given: Given  # what was known beforehand
    style: str  # delimiter and decimal mark
    notes: list[str]  # a sentence for each thing that was left out, filled in or looks wrong
    length_mm: float | None  # of the straight finger; proposed where `given` has none
    faults: list[str]  # what the rules of a recording refuse, by the names of the tables


def table_files(path: str | Path) -> list[Path]:
    """The files that a `--recording=` names: one, several with commas, or a pattern; empty of a folder.

    Raises:
        InputError: there is no such file, or it is of a kind that is not read.
    """
    text = str(path)
    if Path(path).is_dir():
        return []
    parts = [text] if Path(path).is_file() else [p.strip() for p in text.split(",") if p.strip()]
    files: list[Path] = []
    for part in parts:
        if glob.has_magic(part) and not Path(part).exists():
            found, near = [Path(p) for p in glob.glob(part) if Path(p).is_file()], []
        elif Path(part).suffix.lower() in (*FILES, *SPREADSHEETS) or Path(part).is_file():
            found = [Path(part)] if Path(part).is_file() else []
            near = sorted(p.name for p in Path(part).absolute().parent.glob(f"*{Path(part).suffix}"))
        else:
            return []
        if not found:
            there = f"; there is {listed(near)}" if near else ""
            raise InputError(f"There is no file '{part}'{there}.")
        files += found
    for file in files:
        if file.suffix.lower() in SPREADSHEETS:
            raise InputError(f"{file} is a spreadsheet; save its sheet as 'CSV UTF-8' and give that file.")
        if file.suffix.lower() not in FILES:
            raise InputError(f"{file} is none of {', '.join(FILES)}; give a table or a recording's folder.")
    # by pieces, texts and numbers in turn: `run_2` comes before `run_10`
    pieces = {f: re.split(r"(\d+)", str(f)) for f in files}
    return sorted(pieces, key=lambda f: [int(p) if p.isdigit() else p for p in pieces[f]])


def folder_of(files: Sequence[Path]) -> Path:
    """Where the recording of these files is stored: next to the first, by the names of the first and last."""
    first, last = files[0], files[-1]
    return first.with_name((first.stem if len(files) == 1 else f"{first.stem}_to_{last.stem}") + ENDING)


def is_current(folder: Path, files: Sequence[Path], mapping: Path | None = None) -> bool:
    """Whether a folder holds the recording of these files as they and its mapping are now."""
    try:
        stamp = json.loads((folder / "recording.json").read_text(encoding="utf-8"))["source"]
        same = stamp == _stamp(folder, files)
        return same and (mapping is None or Given.load(mapping) == Given.load(folder / MAPPING))
    except (OSError, ValueError, KeyError, TypeError, InputError):
        return False


def is_ours(folder: Path) -> bool:
    """Whether an earlier conversion wrote this folder."""
    return (folder / MAPPING).is_file()


def _stamp(folder: Path, files: Sequence[Path]) -> dict:
    """Of what a recording was made, by which its age is known."""
    return {"files": {f.name: _digest(f) for f in files}, "mapping": _digest(folder / MAPPING)}


def _digest(file: Path) -> str:
    with file.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


# ---------------------------------------------------------------- reading


def read_table(file: Path, time: str = "") -> TextTable:
    """A table of text, Parquet or MATLAB; raises InputError where it is none, or is motion capture."""
    if file.suffix.lower() == ".mat":
        return readers.mat_table(file, time)
    if file.suffix.lower() == ".parquet":
        frame = reading.read_parquet(file)
        frame = frame.rename(columns=str).reset_index(drop=True)
        return TextTable(file, frame, {}, np.arange(len(frame)) + 1, "Parquet")
    if readers.is_optitrack(file) or readers.is_vicon(file):
        raise InputError(
            f"{file} is a take of motion capture; `pneutac convert {file} --tip=NAME --base=NAME"
            " --log=VALVE.csv` reads it."
        )
    return read_text(file)


def understand_files(files: Sequence[Path], given: Given, log: bool = False, time: str = "") -> Understood:
    """Reads tables with a header, in the order of their trials, understands their columns and converts them.

    With `log` the pose comes from elsewhere, and no rule of a recording is applied; `time` names the times of
    a .mat.

    Raises:
        InputError: one sentence: what cannot be read, or is open and how to say it.
    """
    read = [read_table(f, time) for f in files]
    notes = [n for t in read for n in t.notes]
    _same_columns(read, notes)
    source = str(files[0]) if len(files) == 1 else f"{files[0]} to {files[-1].name}"
    frame = pd.concat([t.frame for t in read], ignore_index=True)
    if not len(frame):
        raise InputError(f"{files[0]} has a header but no rows; record at least one trial.")
    of_file = np.repeat(np.arange(len(read)), [len(t.frame) for t in read])
    units = {k: v for t in read for k, v in t.units.items()}
    empty = [c for c in frame if frame[c].isna().all()]
    if empty:
        notes.append(
            f"{source}: {listed(map(shown, empty))} {'is' if len(empty) == 1 else 'are'} empty, left out."
        )
        frame = frame.drop(columns=empty)
    columns = understand(frame, units, given.columns, source, given.length_mm, log)
    table = _converted(frame, columns, of_file, given, read, notes, log)
    keep = _rows_with_tip(table, source, notes) if not log else np.ones(len(table), bool)
    table, of_file = table[keep], of_file[keep]
    _filled(table, columns, read, notes)
    _into_base(table, given, columns, source)
    rest = _at_rest(table)
    reach = float(np.linalg.norm(rest)) if rest is not None else 0.0
    length_mm = given.length_mm or (float(round(reach)) if 2 <= reach <= 1000 else None)
    meta = {"length_mm": length_mm, "date": given.date or _date(frame, columns)}
    meta = {k: v for k, v in meta.items() if v not in (None, "")}
    if given.length_mm is None and length_mm:
        meta["length_proposed"] = True
    device = "arm" if "pressure_cmd_1_kpa" in table else "finger"
    meta |= {"notes": f"from {', '.join(f.name for f in files)}"}
    recording = Recording(files[0].parent, meta, table.reset_index(drop=True), device)
    faults = [] if log else _checked(recording, columns, read, of_file, keep, notes)
    if not log and not faults:
        notes += _axes_notes(recording, source, given)
    meta["conversion"] = {"notes": notes, "rows_left_out": int((~keep).sum())}
    return Understood(list(files), recording, columns, given, read[0].style, notes, length_mm, faults)


def _same_columns(read: Sequence[TextTable], notes: list[str]) -> None:
    """Raises InputError where files have other columns than the first; without a payload it is 0."""
    union = list(dict.fromkeys(c for t in read for c in t.frame))
    for t in read:
        for name in (c for c in union if c not in t.frame):
            if read_name(name).kind == "payload":
                notes.append(f"{t.file} has no {shown(name)}: 0 there.")
                t.frame[name] = 0.0
                continue
            other = next(o for o in read if name in o.frame)
            raise InputError(
                f"{t.file} has no column {shown(name)}, which {other.file} has; give all the same columns."
            )


def _converted(
    frame: pd.DataFrame, columns: list[Column], of_file: np.ndarray, given: Given, read: Sequence[TextTable],
    notes: list[str], log: bool,
) -> pd.DataFrame:  # fmt: skip
    """The table by the recording's names and units, with trials and a clock in seconds."""
    found: dict[str, pd.Series] = {}
    for c in columns:
        if c.column == LEAVE_OUT:
            continue
        name = re.sub(r"^[=+@\-\s]+", "", c.column) or "column"
        if name in found:
            raise InputError(f"{read[0].file}: {shown(c.name)} and another column both become {shown(name)}.")
        found[name] = c.converted(frame[c.name])
    clock = next((c for c in columns if c.column == "time_s"), None)
    if clock is not None:
        found["time_s"] = _seconds(frame[clock.name], found["time_s"], clock, of_file, given, read)
        sent, raw = found.get("time_sent_s"), frame[clock.name]
        if sent is not None and sent.dtype.kind in "fiu" and raw.dtype.kind in "fiu":
            found["time_sent_s"] = sent + (found["time_s"] - clock.converted(raw))
    elif given.rate_hz:
        within = np.arange(len(frame)) - np.searchsorted(of_file, of_file)
        found["time_s"] = pd.Series(within / given.rate_hz)
    else:
        raise InputError(
            f"{read[0].file}: no column is a time; it has {listed(map(shown, frame))}. Name it by"
            " --columns='NAME: time_s', or give the rows a second by --rate_hz."
        )
    trial, more = _trials(found.pop("trial", None), found["time_s"], of_file, read, log)
    notes += more
    table = {"trial": trial, "time_s": found.pop("time_s")} | found
    if len(read) > 1 and "run" not in table:
        table["run"] = pd.Series([read[i].file.stem for i in of_file])
    return pd.DataFrame(table)


def _seconds(
    raw: pd.Series, values: pd.Series, clock: Column, of_file: np.ndarray, given: Given,
    read: Sequence[TextTable],
) -> pd.Series:  # fmt: skip
    """Times in seconds; those since 1970, of a day or of a calendar begin with 0 in each file."""
    file, source = read[0].file, shown(clock.name)
    if raw.dtype.kind not in "fiu":
        stamps = _stamps(raw, read, of_file, source)
    elif clock.unit is not None and clock.unit.name == "frames":
        if not given.rate_hz:
            raise InputError(f"{file}: {source} counts frames; give their number a second by --rate_hz.")
        stamps = values.astype(float) / given.rate_hz
    else:
        factor = (clock.unit.factor if clock.unit else 1.0) * clock.factor
        if raw.dropna().abs().max() * factor < EPOCH_S:
            return values.astype(float)
        # Differences first: nanoseconds since 1970 have more digits than a float.
        return ((raw - raw.groupby(of_file).transform("min")).astype(float) * factor).round(9)
    return (stamps - stamps.groupby(of_file).transform("min")).round(9)


def _stamps(raw: pd.Series, read: Sequence[TextTable], of_file: np.ndarray, source: str) -> pd.Series:
    """Seconds of texts: times of a day, or ISO and German dates with a time."""
    texts = raw.astype("string").str.strip().str.replace(r"(\d),(\d+)", r"\1.\2", regex=True)
    day = texts.str.extract(r"^(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:\.\d+)?)$").astype(float)
    if texts.dropna().str.fullmatch(r"(\d+:)?\d{1,2}:\d{1,2}(\.\d+)?").all() and len(texts.dropna()):
        stamps = day[0].fillna(0.0) * 3600 + day[1] * 60 + day[2]
        back = (stamps.diff() < -43200).groupby(of_file).cumsum()  # midnight
        return stamps + 86400.0 * back
    german = texts.str.contains(r"^\d{1,2}\.\d{1,2}\.\d{4}", regex=True).fillna(False).mean() > 0.5
    with np.errstate(all="ignore"):
        try:
            how = {"format": "mixed" if german else "ISO8601", "dayfirst": bool(german)}
            parsed = pd.to_datetime(texts, errors="coerce", utc=True, **how)
            if parsed.notna().sum() < 0.5 * texts.notna().sum():
                parsed = pd.to_datetime(texts, format="mixed", errors="coerce", utc=True)
        except (ValueError, OverflowError, TypeError):
            parsed = pd.Series(pd.NaT, index=texts.index)
    bad = parsed.isna().to_numpy()
    if bad.any():
        row = int(np.argmax(bad))
        k = int(of_file[row])
        line = read[k].lines[row - int(np.searchsorted(of_file, k))]
        value = "empty" if pd.isna(raw.iloc[row]) else shown(str(raw.iloc[row]))
        raise InputError(
            f"{read[k].file}: column {source}, line {line} is {value}, which is no time"
            f" ({plural(int(bad.sum()), 'such row')}); write seconds, or times as 2026-03-01T12:00:00.05."
        )
    return (parsed - parsed.min()).dt.total_seconds()


def _trials(
    given: pd.Series | None, time_s: pd.Series, of_file: np.ndarray, read: Sequence[TextTable], log: bool
) -> tuple[np.ndarray, list[str]]:
    """Number of the trial (n,) of each row, and how it was found."""
    n = len(of_file)
    if given is not None:
        numbers = pd.to_numeric(given, errors="coerce")
        whole = numbers.notna().all() and (numbers == numbers.round()).all()
        pairs = pd.MultiIndex.from_arrays([of_file, given.astype(object)])
        if whole:
            distinct = pairs.unique()
            if len({int(v) for _, v in distinct}) == len(distinct):  # also over several files
                return numbers.to_numpy(int), []
        elif given.isna().any():
            row = int(given.isna().to_numpy().argmax())
            raise InputError(
                f"{read[int(of_file[row])].file}: the column of runs is empty in row {row + 1}; number every"
                " row."
            )
        return pd.factorize(pairs)[0], []
    if log:
        return of_file.copy(), []
    time, other_file = time_s.to_numpy(float), np.r_[True, of_file[1:] != of_file[:-1]]
    back = np.r_[False, np.diff(time) < 0] & ~other_file
    begins = back | other_file
    starts = np.flatnonzero(begins)
    shuffled = np.diff(np.r_[starts, n]).min() < 5 or np.ptp(time[starts]) > 1.0 + 0.05 * np.ptp(time)
    if not back.any() or shuffled:  # of shuffled rows the rules name one
        return of_file.copy(), []
    notes = [f"A new run begins wherever the clock starts again: {len(starts)} runs."]
    return np.cumsum(begins) - 1, notes


def _rows_with_tip(table: pd.DataFrame, source: str, notes: list[str]) -> np.ndarray:
    """Rows (n,) in which all of the pose was measured."""
    pose = [c for c in table if re.fullmatch(r"tip_[xyz]_mm|bend_angle_rad|q_\d+_rad", c)]
    seen = table[pose].notna().all(axis=1).to_numpy()
    if not seen.all() and seen.any():
        notes.append(f"{source}: {plural(int((~seen).sum()), 'row')} without {' or '.join(pose)} left out.")
    return seen if seen.any() else np.ones(len(table), bool)


def _filled(
    table: pd.DataFrame, columns: Sequence[Column], read: Sequence[TextTable], notes: list[str]
) -> None:
    """Fills gaps of conditions with the last value of the trial; what drives or times the device has none."""
    names = {c.column: c.name for c in columns}
    for name in (n for n in table if not re.fullmatch(r"trial|time(_sent)?_s|pressure_cmd_(\d+_)?kpa", n)):
        gaps = int(table[name].isna().sum())
        if not gaps:
            continue
        table[name] = table.groupby("trial")[name].ffill()
        table[name] = table.groupby("trial")[name].bfill()
        if table[name].isna().any() and table[name].dtype.kind not in "fiu":
            table[name] = table[name].fillna("none")
        notes.append(
            f"{shown(names.get(name, name))} is empty in {plural(gaps, 'row')}: the last value holds."
        )


def _into_base(table: pd.DataFrame, given: Given, columns: Sequence[Column], source: str) -> None:
    """Turns and shifts what is in the table's frame into the base's, in place."""
    base = np.array(given.base_mm, float)
    marker = [f"base_{a}_mm" for a in "xyz"]
    if all(m in table for m in marker):
        base = base + table[marker].median().to_numpy(float)
        table.drop(columns=marker, inplace=True)
    axes = axes_of(given.base_x, given.base_z)
    if not base.any() and np.array_equal(axes, np.eye(3)):
        return
    for pattern in VECTORS:
        names = [pattern.format(a) for a in "xyz"]
        have = [n for n in names if n in table]
        if not have:
            continue
        values = table.reindex(columns=names, fill_value=0.0).to_numpy(float)
        values = (values - base if names == TIPS else values) @ axes
        turned = np.abs(axes[[n in table for n in names]]).sum(0) > 0  # measured in the new frame
        for i, n in enumerate(names):
            if turned[i]:
                table[n] = values[:, i]
            elif n in table:
                table.drop(columns=n, inplace=True)


def _at_rest(table: pd.DataFrame) -> np.ndarray | None:
    """Where the tip is (3,), mm, at the least pressures; None where it was not measured."""
    commands = rules.pressure_commands(table)
    if "tip_x_mm" not in table or not commands:
        return None
    try:
        driven = table[commands].abs().max(axis=1).to_numpy(float)
        rest = table[driven <= np.nanquantile(driven, REST_SHARE)]
        return np.array([float(rest[t].median()) if t in table else 0.0 for t in TIPS])
    except (TypeError, ValueError):
        return None  # texts, which the rules refuse


def _axes_notes(recording: Recording, source: str, given: Given) -> list[str]:
    """Whether the resting tip lies along x and positive pressure bends towards z.

    Raises:
        InputError: the tip does not rest along x, so base or axes must be others.
    """
    table = recording.samples
    rest = _at_rest(table)
    tips = [t for t in TIPS if t in table]
    if rest is None or not np.linalg.norm(rest) > 0 or len(tips) < 2:
        return []
    moved = float(np.linalg.norm([np.ptp(table[t]) for t in tips]))
    if np.linalg.norm(rest) < FROM_TIP * moved:
        raise InputError(
            f"{source}: at rest the tip is {np.linalg.norm(rest):.3g} mm from the origin and moves"
            f" {moved:.3g} mm: its place is counted from the tip; give that of the base, as"
            f" `pneutac convert {source} --base=-LENGTH,0,0`."
        )
    share = rest / np.linalg.norm(rest)
    if share[0] < ALONG:
        i = int(np.abs(share).argmax())
        sign = "-" if share[i] < 0 else ""
        place = ", ".join(f"{v:.4g}" for v in rest)
        hint = f" --base_x={sign}{'xyz'[i]}" if abs(share[i]) > 0.9 and given.base_x == "x" else ""
        raise InputError(
            f"{source}: at rest the tip is at ({place}) mm, not along x from the base; give the base's"
            f" position in the table's frame and its axes, as `pneutac convert {source} --base=X,Y,Z"
            f"{hint or ' --base_x=AXIS --base_z=AXIS'}`."
        )
    command = recording.pressure_columns
    if recording.device != "finger" or not command or not np.ptp(table[command[0]]) > 0:
        return []
    kpa = table[command[0]].to_numpy(float)
    kpa = kpa - kpa.mean()
    bends = {a: float(kpa @ table[f"tip_{a}_mm"].to_numpy(float)) for a in "yz" if f"tip_{a}_mm" in table}
    spread = {a: float(np.ptp(table[f"tip_{a}_mm"])) for a in bends}
    if spread.get("y", 0) > 3 * spread.get("z", 0.0) and given.base_z == "z":
        way = "y" if bends["y"] > 0 else "-y"
    elif "z" in bends and bends["z"] < -0.2 * len(kpa) * kpa.std() * table["tip_z_mm"].std():
        way = given.base_z[1:] if given.base_z.startswith("-") else f"-{given.base_z}"
    else:
        return []
    return [f"Pressure bends the finger along {way}, but z must point that way: convert with --base_z={way}."]


def _date(frame: pd.DataFrame, columns: Sequence[Column]) -> str:
    """Day of the measurement, if the clock is unambiguous."""
    clock = next((c for c in columns if c.column == "time_s"), None)
    first = None if clock is None else frame[clock.name].iloc[0]
    if isinstance(first, str):
        iso = re.match(r"(\d{4})-(\d\d)-(\d\d)", first)
        german = re.match(r"(\d{1,2})\.(\d{1,2})\.(\d{4})", first)
        parts = iso.groups() if iso else german.groups()[::-1] if german else ()
        return "-".join(f"{int(p):02d}" for p in parts)
    if clock is None or not isinstance(first, int | float | np.number):
        return ""
    seconds = float(first) * (clock.unit.factor if clock.unit else 1.0)
    return f"{pd.Timestamp(seconds, unit='s'):%Y-%m-%d}" if 1e9 < seconds < 4e9 else ""


def _checked(
    recording: Recording, columns: Sequence[Column], read: Sequence[TextTable], of_file: np.ndarray,
    keep: np.ndarray, notes: list[str],
) -> list[str]:  # fmt: skip
    """What the rules of a recording refuse, by file, line and column of the tables; drops repeated stamps."""
    names = {c.column: c.name for c in columns if c.column not in ("", LEAVE_OUT)}

    def renamed(sentence: str) -> str:
        return re.sub(r"'([^']+)'", lambda m: shown(names.get(m[1], m[1])), sentence)

    faults, begin, repeated = [], 0, np.zeros(len(of_file), bool)
    for k, table in enumerate(read):
        inside = keep[begin : begin + len(table.frame)]
        begin += len(table.frame)
        source = SourceFile(table.file)
        source.lines = table.lines[inside]
        part = recording.samples[of_file == k].reset_index(drop=True)
        if not len(part):
            faults.append(f"{table.file} has no row in which the tip was seen.")
            continue
        meta = {k: v for k, v in recording.meta.items() if k == "length_mm"}
        try:
            rules.check_samples(part, recording.device, meta, source)
        except InputError as e:
            text = renamed(str(e))
            if text not in faults:
                faults.append(text)
            continue
        reported: list[str] = []
        once = rules.check_time(part, source, reported).index
        if len(once) < len(part):
            notes.append(renamed(reported[0]))
            repeated[np.flatnonzero(of_file == k)[~part.index.isin(once)]] = True
    recording.samples = recording.samples[~repeated].reset_index(drop=True)
    return faults


# ---------------------------------------------------------------- writing


def write(understood: Understood, folder: Path) -> Recording:
    """Writes the recording with its `mapping.yaml` and reads it back with all checks.

    What somebody added to an earlier `recording.json` there (noise, starts of trials, notes) stays.

    Raises:
        InputError: the rules refuse it, or the folder cannot be written.
    """
    if understood.faults:
        raise InputError(understood.faults[0])
    recording = understood.recording
    earlier = {}
    if (folder / "recording.json").is_file():
        earlier = reading.read_meta(folder)
        earlier = {k: v for k, v in earlier.items() if k not in REWRITTEN}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / MAPPING, understood.given.text(understood.columns, understood.given.length_mm))
        stamp = _stamp(folder, understood.files)
        meta = recording.meta | earlier | {"source": stamp}
        replace(recording, meta=meta).write(folder)
    except OSError as e:
        raise InputError(
            f"{folder} cannot be written ({e.strerror or e}); convert into a folder of yours:"
            f" `pneutac convert {understood.files[0]} --out=FOLDER`."
        ) from e
    return Recording.load(folder)


def extent(recording: Recording) -> str:
    """`10 runs, 8.6 minutes, 20 Hz`."""
    time = recording.samples.groupby("trial")["time_s"]
    seconds = float((time.max() - time.min()).sum())
    steps = np.concatenate([np.diff(g.to_numpy(float)) for _, g in time] or [np.zeros(0)])
    steps = steps[steps > 0]
    rate = f", {1 / float(np.median(steps)):.3g} Hz" if len(steps) else ""
    length = f"{seconds / 60:.2g} minutes" if seconds >= 60 else f"{seconds:.3g} s"
    return f"{plural(len(recording.trials()), 'run')}, {length}{rate}"
