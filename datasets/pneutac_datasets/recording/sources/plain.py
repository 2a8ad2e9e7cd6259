"""One plain table or several, of a lab's own names and units, as a bench recording next to them."""

import contextlib
import glob
import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import join, quote

import numpy as np
import pandas as pd
import yaml

from pneutac_datasets.recording import rules
from pneutac_datasets.recording.checks import RIGHT_AXES, base_axes
from pneutac_datasets.recording.recording import Recording, count_left_out, read_meta, read_parquet
from pneutac_datasets.recording.sources import readers
from pneutac_datasets.recording.sources.columns import (
    LEAVE_OUT,
    Column,
    guesses,
    meant,
    parse_columns,
    read_name,
    seeming,
    understand,
)
from pneutac_datasets.recording.sources.readers import AXES, REST_SHARE, axes_of
from pneutac_datasets.recording.text_table import TextTable, read_text
from pneutac_datasets.recording.units import BASE_UNIT
from pneutac_datasets.recording.wording import SourceFile, collected, grouped, listed, plural
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import read_fields, read_yaml, write_text

ENDING = ".recording"  # of the folder next to the files
MAPPING = "mapping.yaml"  # there, what the columns are
# Fields of `recording.json` that each conversion writes anew.
REWRITTEN = ("length_mm", "length_proposed", "samples", "source", "conversion")
TEXT = (".csv", ".txt", ".tsv", ".tab", ".dat", ".log", ".asc", ".prn")
FILES = (*TEXT, ".mat", ".npz", ".parquet")
SPREADSHEETS = (".xlsx", ".xls", ".xlsm", ".ods", ".numbers")
TIPS = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
VECTORS = "tip_{}_mm", "force_{}_n", "gravity_{}"
DRIVES = r"trial|time(_sent)?_s|pressure_cmd_(\d+_)?kpa"  # columns that drive or time the device
ZERO_SHARE = 0.01  # of the largest command: at less there is no pressure
ALONG = 0.7  # cosine between the resting tip and x, below which the axes must be others
FROM_TIP = 0.2  # of its motion: nearer to the origin than that no resting tip is to its base
FROM_ZERO = 0.1  # of its usual distance: nearer to the base comes no tip
EPOCH_S = 1e8  # a clock beyond this counts since 1970
HALF_DAY_S = rules.DAY_S / 2
STAMP = "stamp [ns]"  # name of a clock that stands in two columns
USUAL_MM = 25.0, 350.0  # length of a finger; of another the tip's unit or origin may be wrong
LIES = "the straight finger lies along {} and pressure bends it along {}, where x and z must point"
NOON_S = 60.0  # at most between the last row before one o'clock and the first after it
PAUSE_S = 600.0  # between two rows: what happened in so long a pause is unknown, so that a new run begins


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
            given |= {k: kind(given[k]) for k, kind in KINDS.items() if k in given}
            x, y, z = (float(v) for v in given.pop("base_mm", cls.base_mm))
            if not isinstance(given.get("columns", {}), dict):
                raise ValueError("columns must be names and what they are")
        except (TypeError, ValueError) as e:
            raise InputError(f"{file} is no mapping: {e}.") from e
        return cls(parse_columns(given.pop("columns", {})), (x, y, z), **given)

    def options(self) -> list[str]:
        """As options of `pneutac convert`."""
        quoted = {n: f'"{n}"' if set(n) & set(",:") else n for n in self.columns}
        columns = ", ".join(f"{quoted[n]}: {column}" for n, column in self.columns.items())
        base = ",".join(f"{v:g}" for v in self.base_mm)
        given = {"columns": columns, "base": base * any(self.base_mm)} | {k: getattr(self, k) for k in KINDS}
        shown = {k: f"{v:g}" if isinstance(v, float) else v for k, v in given.items() if v}
        return [f"--{k}={v}" for k, v in shown.items() if v != getattr(Given, k, None)]

    def turned(self, x: str, z: str) -> "Given":
        """With other axes of the base, `x` and `z`, which are named in the frame of these."""
        old = axes_of(self.base_x, self.base_z)
        x, z = (next(a for a, v in AXES.items() if np.allclose(v, old @ AXES[way])) for way in (x, z))
        return replace(self, base_x=x, base_z=z)

    def text(self, columns: Sequence[Column]) -> str:
        """The content of `mapping.yaml` once the columns are known."""
        content = vars(self) | {"columns": {c.name: str(c) for c in columns}, "base_mm": list(self.base_mm)}
        content = {k: v for k, v in content.items() if v not in (None, "")}
        head = "# What the columns of the table are; `pneutac convert` and every --mapping read it.\n"
        return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=1000)


KINDS = {"base_x": str, "base_z": str, "length_mm": float, "rate_hz": float, "date": str}  # of `Given`


def table_files(path: str | Path) -> list[Path]:
    """The files that a `--recording=` names: one, several with commas, or a pattern; empty of a folder.

    Raises InputError: there is no such file, or it is of a kind that is not read.
    """
    text = str(path)
    if Path(path).is_dir():
        return []
    parts = [text] if Path(path).is_file() else [p.strip() for p in text.split(",") if p.strip()]
    files: list[Path] = []
    for part in map(Path, parts):
        found = [part] if part.is_file() else [p for p in map(Path, glob.glob(str(part))) if p.is_file()]
        pattern = glob.has_magic(str(part))
        if not (found or pattern or part.suffix.lower() in (*FILES, *SPREADSHEETS)):
            return []
        if not found:
            near = sorted(p.name for p in part.absolute().parent.glob(f"*{part.suffix}") if not pattern)
            raise InputError(f"There is no file '{part}'{f'; there is {listed(near)}' if near else ''}.")
        files += found
    for file in files:
        if file.suffix.lower() in SPREADSHEETS:
            raise InputError(f"{file} is a spreadsheet; save its sheet as 'CSV UTF-8' and give that file.")
        if file.suffix.lower() not in FILES:
            raise InputError(f"{file} is none of {', '.join(FILES)}; give a table or a recording's folder.")
    # texts and numbers in turn: `run_2` comes before `run_10`
    return sorted(files, key=lambda f: [int(p) if p.isdigit() else p for p in re.split(r"(\d+)", str(f))])


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


def is_unfinished(folder: Path) -> bool:
    """Whether a conversion was interrupted in this folder, or it is empty."""
    names = {p.name for p in folder.iterdir() if p.suffix != ".part"} if folder.is_dir() else {""}
    return not names or {MAPPING} <= names <= {MAPPING, "samples.csv"}


def _stamp(folder: Path, files: Sequence[Path]) -> dict:
    """Of what a recording was made, by which its age is known."""
    *digests, mapping = (hashlib.sha256(f.read_bytes()).hexdigest() for f in (*files, folder / MAPPING))
    return {"files": dict(zip([f.name for f in files], digests, strict=True)), "mapping": mapping}


def read_table(file: Path, time: str = "") -> TextTable:
    """A table of text, Parquet, MATLAB or NumPy; raises InputError where it is none, or is motion capture."""
    if file.suffix.lower() == ".mat":
        return readers.mat_table(file, time)
    if file.suffix.lower() == ".npz":
        return readers.npz_table(file, time)
    if file.suffix.lower() == ".parquet":
        frame = read_parquet(file).rename(columns=str).reset_index(drop=True)
        return TextTable(file, frame, {}, np.arange(len(frame)) + 1, "Parquet")
    if readers.is_optitrack(file) or readers.is_vicon(file):
        raise InputError(
            f"{file} is a take of motion capture; `pneutac convert {quote(str(file))} --tip=NAME --base=NAME"
            " --log=VALVE.csv` reads it."
        )
    return read_text(file)


class Understood:
    """Tables with a header, in the order of their trials, as one recording, and how they were understood.

    With `log` the pose comes from elsewhere, and no rule of a recording is applied; `time` names the times of
    a .mat. Raises InputError: what cannot be read, or is open and how to say it.

    Attributes:
        recording: not written yet.
        columns: what each column of the tables is.
        style: delimiter and decimal mark.
        notes: a sentence for each thing that was left out, filled in or looks wrong.
        length_mm: of the straight finger; proposed where `given` has none.
        guessed: a sentence on units of the pose that nobody wrote; empty where all are written.
        faults: what the rules of a recording refuse, by the names of the tables.
    """

    def __init__(self, files: Sequence[Path], given: Given, log: bool = False, time: str = ""):
        self.files, self.given, self._log = list(files), given, log
        self._read = [read_table(f, time) for f in files]
        for table in self._read:
            _one_stamp(table, given)
        self.style, self.notes = self._read[0].style, [n for t in self._read for n in t.notes]
        self._source = str(files[0]) if len(files) == 1 else f"{files[0]} to {files[-1].name}"
        tables = quote(",".join(map(str, files)))
        self._convert = f"pneutac convert {f'SOURCE --log={tables}' if log else tables}"
        frame = self._one_frame()
        units = {k: v for t in self._read for k, v in t.units.items()}
        self.columns = understand(
            frame, units, given.columns, self._source, given.length_mm, log, self._convert, self._empty
        )
        self.guessed, have = guesses(self.columns), {c.column: c for c in self.columns}
        self._clock = have.get("time_s")
        for c in (c for c in self.columns if c.name not in given.columns):
            if (target := meant(c)) and target not in have:
                answer = quote(f"{c.name}: {target}")
                self.notes.append(
                    f"{self._source}: {shown(c.name)} is stored as it is; if it is {target}, `{self._convert}"
                    f" --columns={answer}` takes it as that."
                )
        self._began, self._absolute = np.zeros(len(files)), False  # when files begin, by one clock or not
        table, left_out = self._seen(self._converted(frame))
        self._fill(table)
        self._into_base(table)
        rest = _at_rest(table)
        reach = float(np.linalg.norm(rest)) if rest is not None else 0.0
        self.length_mm = given.length_mm or (float(round(reach)) if 2 <= reach <= 1000 else None)
        if given.length_mm is None and self.length_mm and not USUAL_MM[0] <= self.length_mm <= USUAL_MM[1]:
            self.notes.append(
                f"{self._source}: at rest the tip is {self.length_mm:g} mm from the origin, where a"
                " finger is 40 to 250 mm long; check its unit, give the base's place if it is elsewhere"
                f" (`{self._convert} --base=X,Y,Z`), or the measured length (--length_mm)."
            )
        proposed = given.length_mm is None and self.length_mm is not None
        meta = {"length_mm": self.length_mm, "date": given.date or self._date(frame)}
        meta |= {"length_proposed": proposed or None, "notes": f"from {', '.join(f.name for f in files)}"}
        meta |= {"trials": {} if log else self._pauses(table)}
        meta = {k: v for k, v in meta.items() if v not in (None, "", {})}
        device = "arm" if "pressure_cmd_1_kpa" in table else "finger"
        self.recording = Recording(files[0].parent, meta, table, device)
        self.faults = [] if log else self._faults() or self._axes_faults()
        self.notes = grouped(self.notes)
        meta["conversion"] = {"notes": self.notes, "rows_left_out": left_out}

    def _one_frame(self) -> pd.DataFrame:
        """The rows of all files, which must have the same columns; without a payload it is 0."""
        union = list(dict.fromkeys(c for t in self._read for c in t.frame))
        for t in self._read:
            for name in (c for c in union if c not in t.frame):
                if read_name(name).kind != "payload":
                    other = next(o for o in self._read if name in o.frame)
                    raise InputError(
                        f"{t.file} has no column {shown(name)}, which {other.file} has; give all the same"
                        " columns."
                    )
                self.notes.append(f"{t.file} has no {shown(name)}: 0 there.")
                t.frame[name] = 0.0
        frame = pd.concat([t.frame for t in self._read], ignore_index=True)
        if not len(frame):
            raise InputError(f"{self.files[0]} has a header but no rows; record at least one trial.")
        self._of_file = np.repeat(np.arange(len(self._read)), [len(t.frame) for t in self._read])
        self._line = np.concatenate([t.lines for t in self._read])
        self._empty = empty = [c for c in frame if frame[c].isna().all()]
        if empty:
            are = "is" if len(empty) == 1 else "are"
            self.notes.append(
                f"{self._source}: {listed(map(shown, empty))} {are} empty or not a number, left out."
            )
        return frame.drop(columns=empty)

    def _converted(self, frame: pd.DataFrame) -> pd.DataFrame:
        """The table by the recording's names and units, with trials and a clock in seconds."""
        file, clock, found = self.files[0], self._clock, {}
        for c in (c for c in self.columns if c.column != LEAVE_OUT):
            name = re.sub(r"^[=+@\-\s]+", "", c.column) or "column"
            if name in found:
                raise InputError(f"{file}: {shown(c.name)} and another column both become {shown(name)}.")
            found[name] = c.converted(frame[c.name])
        if clock is not None:
            raw = frame[clock.name]
            found["time_s"] = self._seconds(raw, found["time_s"], clock)
            sent = found.get("time_sent_s")
            if sent is not None and sent.dtype.kind in "fiu" and raw.dtype.kind in "fiu":
                found["time_sent_s"] = sent + (found["time_s"] - clock.converted(raw))
        elif self.given.rate_hz:
            within = np.arange(len(frame)) - np.searchsorted(self._of_file, self._of_file)
            found["time_s"] = pd.Series(within / self.given.rate_hz)
        else:
            named = quote((seeming(self.columns, "time", "s|ms") or ["NAME: time_s"])[0])
            raise InputError(
                f"{file}: no column is a time; it has {listed(map(shown, frame))}. Name it by"
                f" `{self._convert} --columns={named}`, or give the rows a second, `{self._convert}"
                " --rate_hz=20`."
            )
        time_s, trial = found.pop("time_s"), found.pop("trial", None)
        trial = self._trials(time_s.to_numpy(float)) if trial is None else self._numbered(trial)
        table = {"trial": trial, "time_s": time_s} | found
        if len(self._read) > 1 and "run" not in table:
            table["run"] = pd.Series([self.files[i].stem for i in self._of_file])
        return pd.DataFrame(table)

    def _seconds(self, raw: pd.Series, values: pd.Series, clock: Column) -> pd.Series:
        """Times in seconds; those since 1970, of a day or of a calendar begin with 0 in each file."""
        if raw.dtype.kind not in "fiu":
            stamps = self._stamps(raw, shown(clock.name))
        elif clock.unit is not None and clock.unit.name == "frames":
            if not self.given.rate_hz:
                counts = f"{shown(clock.name)} counts frames; give their number a second"
                raise InputError(f"{self.files[0]}: {counts} by `{self._convert} --rate_hz=20`.")
            stamps = values.astype(float) / self.given.rate_hz
        else:
            factor = (clock.unit.factor if clock.unit else 1.0) * clock.factor
            if raw.dropna().abs().max() * factor < EPOCH_S:
                return values.astype(float)
            # Differences first: nanoseconds since 1970 have more digits than a float.
            return ((raw - self._firsts(raw, factor)).astype(float) * factor).round(9)
        return (stamps - self._firsts(stamps)).round(9)

    def _firsts(self, values: pd.Series, factor: float = 1.0) -> pd.Series:
        """The first time of each row's file, and in `_began` that of each file in seconds."""
        firsts = values.groupby(self._of_file)
        self._began, self._absolute = firsts.min().to_numpy(float) * factor, True
        return firsts.transform("min")

    def _stamps(self, raw: pd.Series, source: str) -> pd.Series:
        """Seconds of texts: times of a day, or ISO and German dates with a time."""
        texts = raw.astype("string").str.strip().str.replace(r"(\d),(\d+)", r"\1.\2", regex=True)
        day = texts.str.extract(r"^(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:\.\d+)?)$").astype(float)
        if texts.notna().any() and day[1][texts.notna()].notna().all():
            stamps = day[0].fillna(0.0) * 3600 + day[1] * 60 + day[2]
            midnights = (stamps.diff() < -HALF_DAY_S).groupby(self._of_file).cumsum()
            return self._past_noon(stamps + rules.DAY_S * midnights, source)
        german = bool(texts.str.contains(r"^\d{1,2}\.\d{1,2}\.\d{4}", regex=True).fillna(False).mean() > 0.5)
        parsed = pd.Series(pd.NaT, index=texts.index)
        with np.errstate(all="ignore"), contextlib.suppress(ValueError, OverflowError, TypeError):
            how = {"format": "mixed" if german else "ISO8601", "dayfirst": german}
            parsed = pd.to_datetime(texts, errors="coerce", utc=True, **how)
            if parsed.notna().sum() < 0.5 * texts.notna().sum():
                # 08/03 is in March or August, which matters where a recording goes past midnight
                orders = (False, True) if texts.str[:10].nunique() > 1 else (False,)
                mixed = {"format": "mixed", "errors": "coerce", "utc": True}
                both = [pd.to_datetime(texts, dayfirst=order, **mixed) for order in orders]
                parsed = min(both, key=lambda p: (p.isna().sum(), p.max() - p.min()))
        bad = parsed.isna().to_numpy()
        if bad.any():
            row = int(np.argmax(bad))
            value = "empty or not a number" if pd.isna(raw.iloc[row]) else shown(str(raw.iloc[row]))
            raise InputError(
                f"{self.files[self._of_file[row]]}: column {source}, line {self._line[row]}"
                f" is {value}, which is no time ({plural(int(bad.sum()), 'such row')}); write seconds, or"
                " times as 2026-03-01T12:00:00.05."
            )
        return self._past_noon((parsed - parsed.min()).dt.total_seconds(), source)

    def _past_noon(self, stamps: pd.Series, source: str) -> pd.Series:
        """Seconds of a clock of 12 hours without AM and PM, in which 12:59:59 comes before 1:00:00."""
        since = stamps.groupby(self._of_file).diff() + HALF_DAY_S
        noons = (since > 0) & (since < NOON_S)
        if noons.any():
            line = self._line[int(noons.to_numpy().argmax())]
            self.notes.append(
                f"{self._source}: {source} goes from 12 to 1 o'clock in line {line}, without AM or PM:"
                " 12 hours are added from there on."
            )
        return stamps + HALF_DAY_S * noons.groupby(self._of_file).cumsum()

    def _numbered(self, given: pd.Series) -> np.ndarray:
        """Number of the trial (n,) of each row, by the tables' own numbers or names of runs."""
        numbers = pd.to_numeric(given, errors="coerce")
        pairs = pd.MultiIndex.from_arrays([self._of_file, given.astype(object)])
        if numbers.notna().all() and (numbers == numbers.round()).all():
            distinct = pairs.unique()
            if len({int(v) for _, v in distinct}) == len(distinct):  # also over several files
                return numbers.to_numpy(int)
        elif given.isna().any():
            row = int(given.isna().to_numpy().argmax())
            file = self.files[self._of_file[row]]
            raise InputError(
                f"{file}: the column of runs is empty or not a number in row {row + 1}; number every row."
            )
        return pd.factorize(pairs)[0]

    def _trials(self, time: np.ndarray) -> np.ndarray:
        """Number of the trial (n,) of each row by its file, a clock that starts again, or a long pause."""
        other_file, step = np.r_[True, np.diff(self._of_file) != 0], np.r_[0.0, np.diff(time)]
        back = (step < 0) & ~other_file
        begins = np.flatnonzero(back | other_file)
        shuffled = back.any() and np.ptp(time[begins]) > 1.0 + 0.05 * np.ptp(time)
        pause = (step > max(PAUSE_S, 10 * np.median(np.abs(step)))) & ~other_file
        new = back | pause | other_file
        few = np.diff(np.r_[np.flatnonzero(new), len(time)]).min() < 5
        if self._log or not (back | pause).any() or shuffled or few:  # of shuffled rows the rules name one
            return self._of_file.copy()
        where = ["starts again"] * bool(back.any())
        longest = f"pauses for more than {PAUSE_S / 60:g} minutes (the longest {np.max(step):.0f} s)"
        where += [longest] * bool(pause.any())
        self.notes.append(f"A new run begins wherever the clock {' or '.join(where)}: {new.sum()} runs.")
        return np.cumsum(new) - 1

    def _pauses(self, table: pd.DataFrame) -> dict[str, dict]:
        """Runs that go on from the one before after a pause without pressure, where one clock shows it.

        It does where its times rise from run to run. That of a file that does not begin in 1970, at midnight
        or with a date shows nothing of the next file.
        """
        commands, trial = rules.pressure_commands(table), table["trial"].to_numpy()
        begins = np.flatnonzero(np.diff(trial) != 0) + 1
        if not commands or not len(begins) or any(table[c].dtype.kind not in "fiu" for c in commands):
            return {}
        driven = table[commands].abs().max(axis=1).to_numpy(float)
        time_s = pd.to_numeric(table["time_s"], errors="coerce").to_numpy(float) + self._began[self._of_file]
        step, other_file = np.diff(time_s), np.diff(self._of_file) != 0
        known = ~other_file | self._absolute
        zero = driven <= ZERO_SHARE * driven.max()
        if not (step[known] > 0).all():
            return {}
        after = begins[known[begins - 1] & zero[begins] & zero[begins - 1]]
        if not len(after):
            return {}
        gap = step[after - 1]
        runs = f"1 run goes on from the one before it, {gap[0]:.3g}"
        if len(gap) > 1:
            runs = f"{len(gap)} runs go on from those before them, {gap.min():.3g} to {gap.max():.3g}"
        self.notes.append(f"{runs} s later by the clock; no pressure is assumed in between.")
        pauses = zip(trial[after].tolist(), gap.tolist(), strict=True)
        return {str(n): {"start": "continues", "pause_s": round(s, 3)} for n, s in pauses}

    def _seen(self, table: pd.DataFrame) -> tuple[pd.DataFrame, int]:
        """The rows in which all of the pose was measured, and how many are now missing between them."""
        pose = [c for c in table if re.fullmatch(r"tip_[xyz]_mm|bend_angle_rad|q_\d+_rad", c)]
        seen = table[pose].notna().all(axis=1).to_numpy()
        lost, zero = int((~seen).sum()), _at_zero(table)
        seen &= ~zero
        if self._log or seen.all() or not seen.any():
            return table, 0
        if lost:
            self.notes.append(f"{self._source}: {plural(lost, 'row')} without {' or '.join(pose)} left out.")
        if zero.any():
            tips = f"{' and '.join(t for t in TIPS if t in table)} are exactly 0, where no tip can be"
            self.notes.append(f"{self._source}: {plural(int(zero.sum()), 'row')} in which {tips}, left out.")
        self._of_file, self._line = self._of_file[seen], self._line[seen]
        time_s = pd.to_numeric(table["time_s"], errors="coerce").to_numpy(float)
        missing = count_left_out(table["trial"].to_numpy(), time_s, seen)
        return table[seen].reset_index(drop=True), missing

    def _fill(self, table: pd.DataFrame) -> None:
        """Fills gaps of conditions with the trial's last value; what drives or times the device has none."""
        names = {c.column: c.name for c in self.columns}
        for name in (n for n in table if table[n].isna().any() and not re.fullmatch(DRIVES, n)):
            gaps = plural(int(table[name].isna().sum()), "row")
            table[name] = table.groupby("trial")[name].transform(lambda values: values.ffill().bfill())
            if table[name].isna().any() and table[name].dtype.kind not in "fiu":
                table[name] = table[name].fillna("none")
            self.notes.append(
                f"{shown(names.get(name, name))} is empty or not a number in {gaps}: the last value holds."
            )

    def _into_base(self, table: pd.DataFrame) -> None:
        """Turns and shifts what is in the table's frame into the base's, in place."""
        base, marker = np.array(self.given.base_mm, float), [f"base_{a}_mm" for a in "xyz"]
        if all(m in table for m in marker):
            base = base + table[marker].median().to_numpy(float)
            table.drop(columns=marker, inplace=True)
        axes = axes_of(self.given.base_x, self.given.base_z)
        if not base.any() and np.array_equal(axes, np.eye(3)):
            return
        for pattern in VECTORS:
            names = [pattern.format(a) for a in "xyz"]
            if not (have := [n for n in names if n in table]):
                continue
            values = table.reindex(columns=names, fill_value=0.0).to_numpy(float)
            values = (values - base if names == TIPS else values) @ axes
            measured = np.abs(axes[[n in have for n in names]]).sum(0) > 0  # in the new frame
            gone = [n for n, m in zip(names, measured, strict=True) if n in have and not m]
            table.drop(columns=gone, inplace=True)
            for i in np.flatnonzero(measured):
                table[names[i]] = values[:, i]

    def _axes_faults(self) -> list[str]:
        """Whether the resting tip lies along x and positive pressure bends towards z.

        Raises InputError: the place of the base, or its axes, are unknown.
        """
        table, source = self.recording.samples, self._source
        rest, tips = _at_rest(table), [t for t in TIPS if t in table]
        if rest is None or not np.linalg.norm(rest) > 0 or len(tips) < 2:
            return []
        far, moved = float(np.linalg.norm(rest)), float(np.linalg.norm([np.ptp(table[t]) for t in tips]))
        if far < FROM_TIP * moved:
            raise InputError(
                f"{source}: at rest the tip is {far:.3g} mm from the origin and moves {moved:.3g} mm: its"
                f" place is counted from the tip; give that of the base, as `{self._convert}"
                " --base=-LENGTH,0,0`."
            )
        axes = base_axes(self.recording)
        if axes == RIGHT_AXES and rest[0] < ALONG * far:
            place = ", ".join(f"{v:.4g}" for v in rest)
            raise InputError(
                f"{source}: at rest the tip is at ({place}) mm, not along x from the base; give the base's"
                f" position in the table's frame and its axes, as `{self._convert} --base=X,Y,Z"
                " --base_x=AXIS --base_z=AXIS`."
            )
        if axes == RIGHT_AXES:
            return []
        turned, files = self.given.turned(*axes), ",".join(map(str, self.files))
        command = ["pneutac", "convert", files, *turned.options(), *["--yes"] * bool(self.guessed)]
        return [_turn_by(source, (turned.base_x, turned.base_z), command, axes[0] != "x")]

    def _date(self, frame: pd.DataFrame) -> str:
        """Day of the measurement, if the clock is unambiguous."""
        clock = self._clock
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

    def _faults(self) -> list[str]:
        """What the rules refuse, by file, line and column of the tables; repeated stamps are left out."""
        names = {c.column: c.name for c in self.columns if c.column not in ("", LEAVE_OUT)}
        meta = {k: v for k, v in self.recording.meta.items() if k == "length_mm"}
        samples, faults, repeated = self.recording.samples, [], []

        def renamed(sentence: str) -> str:
            sentence = re.sub(r"'([^']+)'", lambda m: shown(names.get(m[1], m[1])), sentence)
            if rules.COARSE in sentence and self._clock is not None:
                stamps = samples["time_s"].drop_duplicates().sort_values()
                rate = len(samples) / len(stamps) / float(stamps.diff().median())
                without = quote(f"{self._clock.name}: {LEAVE_OUT}")
                even = f"`{self._convert} --columns={without} --rate_hz={rate:.3g}`"
                digits = "write the times with more digits, or count evenly spaced rows by"
                return sentence.replace(rules.COARSE, f"{digits} {even}")
            value = re.search(r"column '([^']+)', row .* is (\S+), which can only be (.*)", sentence)
            column = next((c for c in self.columns if value and c.name == value[1]), None)
            if value is None or column is None or column.unit is None or column.unit.factor == 1:
                return sentence
            # the number as the table has it was converted, so no other unit follows from its size
            number = f"{value[2]} {BASE_UNIT[column.unit.dimension]} if it is in {column.unit.name}"
            if value[3].startswith("an error"):
                return f"{sentence[: value.start(2)]}{number}{sentence[value.end(2) :]}"
            alike = [c for c in self.columns if c.unit == column.unit and not c.retained]
            answer = ", ".join(f"{c.name}: {c.column} [UNIT]" for c in alike)
            remedy = f"correct the column, or give the unit: `{self._convert} --columns={quote(answer)}`"
            return f"{sentence[: value.start(2)]}{number}, which cannot be; {remedy}."

        for k, file in enumerate(self.files):
            source, part = SourceFile(file), samples[self._of_file == k]
            source.lines = self._line[self._of_file == k]
            if not len(part):
                faults.append(f"{file} has no row in which the tip was seen.")
                continue
            at = part.index
            rows = part.reset_index(drop=True)
            try:
                clean, warned = rules.check_samples(rows, self.recording.device, meta, source)
            except InputError as e:
                faults.append(renamed(str(e)))
                continue
            if len(clean) < len(part):
                self.notes.append(renamed(warned[0]))
                repeated += list(np.delete(at, clean.index))
        self.recording.samples = samples.drop(index=repeated).reset_index(drop=True)
        if not faults:
            with collected(faults):  # all files together, as they are read back
                whole = self.recording.samples, self.recording.device, meta, Path(self._source)
                self.recording.warnings += map(renamed, rules.check_samples(*whole)[1])
        return list(dict.fromkeys(faults))

    def write(self, folder: Path, replaces: bool = False) -> Recording:
        """Writes the recording with its `mapping.yaml` and reads it back with all checks.

        What somebody added to an earlier `recording.json` there (noise, starts of trials, notes) stays.
        Raises InputError where the rules refuse it, the folder cannot be written, or it holds a conversion
        with other options, unless this one `replaces` it.
        """
        if self.faults:
            raise InputError(self.faults[0])
        earlier = read_meta(folder) if (folder / "recording.json").is_file() else {}
        if is_ours(folder) and not (replaces or is_unfinished(folder)):
            same = read_yaml(folder / MAPPING) == yaml.safe_load(self.given.text(self.columns))
            if not same or set(earlier.get("source", {}).get("files", {})) != {f.name for f in self.files}:
                raise InputError(
                    f"{folder} holds a conversion of other tables or with other options; repeat `pneutac"
                    " convert` with --replace to replace it, or with --out=DIR to write another."
                )
        earlier = {k: v for k, v in earlier.items() if k not in REWRITTEN}
        try:
            write_text(folder / MAPPING, self.given.text(self.columns))
            meta = self.recording.meta | earlier | {"source": _stamp(folder, self.files)}
            replace(self.recording, meta=meta).write(folder)
        except OSError as e:
            raise InputError(
                f"{folder} cannot be written ({e.strerror or e}); convert into a folder of yours:"
                f" `{self._convert} --out=FOLDER`."
            ) from e
        return Recording.load(folder)


def _one_stamp(table: TextTable, given: Given) -> None:
    """Makes one clock of whole seconds and nanoseconds in columns of their own, as ROS writes them."""
    frame = table.frame
    if any(c in frame and re.match(r"time_s\b", text) for c, text in given.columns.items()):
        return
    for name in map(str, frame):
        found = re.fullmatch(r"(.*?)n(?:ano)?(secs?)", name)
        pair = [found[1] + found[2], name] if found else []
        others = [c for c in map(str, frame) if c not in pair]
        clocks = any(c == "time_s" or read_name(c).kind == "time" for c in others)
        if not pair or pair[0] not in frame or clocks:
            continue
        if all(frame[c].dtype.kind in "iu" for c in pair):
            frame[STAMP] = frame[pair[0]].astype("int64") * 10**9 + frame[name].astype("int64")
            table.frame = frame.drop(columns=pair)
            table.notes.append(
                f"{table.file}: {' and '.join(map(shown, pair))} are one time, {shown(STAMP)}."
            )
            return


def _turn_by(source: str, axes: tuple[str, str], command: Sequence[str], other_x: bool) -> str:
    """That a tip is given in other axes than the base's, and the command that turns it, a sentence."""
    lies = f"pressure bends the finger along {axes[1]}, where z must point"
    if other_x:
        lies = LIES.format(*axes)
    elsewhere = " (if the base is not at the origin, give its place too, --base=X,Y,Z)" * other_x
    return f"{source}: {lies}; `{join(command)}` turns it{elsewhere}."


def refuse_other_axes(recording: Recording) -> None:
    """Raises InputError, with what turns it, where a finger's tip is in other axes than its base's."""
    axes = base_axes(recording)
    if axes == RIGHT_AXES:
        return
    folder = Path(recording.folder)
    table = folder / recording.meta.get("samples", "samples.csv")
    if not table.is_file():
        raise InputError(f"{folder}: {LIES.format(*axes)}; turn the columns of the tip.")
    files = [folder.parent / name for name in recording.meta.get("source", {}).get("files", ())]
    if files and is_ours(folder) and all(f.is_file() for f in files) and folder_of(files) == folder:
        turned = Given.load(folder / MAPPING).turned(*axes)
        command = ["pneutac", "convert", ",".join(map(str, files)), f"--mapping={folder / MAPPING}"]
        more, ways = ["--replace"], (turned.base_x, turned.base_z)
    else:
        command, more, ways = ["pneutac", "convert", str(table)], [f"--out={folder}_turned"], axes
    command += Given(base_x=ways[0], base_z=ways[1], length_mm=recording.length_mm).options()
    raise InputError(_turn_by(str(folder), axes, [*command, *more], axes[0] != "x"))


def _at_zero(table: pd.DataFrame) -> np.ndarray:
    """Mask (n,) of rows in which a tracker wrote 0 for each coordinate, as many do where they see nothing."""
    tips = [t for t in TIPS if t in table]
    if len(tips) < 2 or any(table[t].dtype.kind not in "fiu" for t in tips):
        return np.zeros(len(table), bool)
    reach = np.abs(table[tips].to_numpy(float)).max(axis=1)
    zero = reach == 0
    others = reach[~zero & np.isfinite(reach)]
    if not len(others) or np.quantile(others, 0.01) < FROM_ZERO * np.median(others):
        return np.zeros(len(table), bool)  # counted from near the tip itself
    return zero


def _at_rest(table: pd.DataFrame) -> np.ndarray | None:
    """Where the tip is (3,), mm, at the least pressures; None where it was not measured."""
    commands = rules.pressure_commands(table)
    if not commands or "tip_x_mm" not in table and sum(t in table for t in TIPS) < 2:
        return None
    try:
        driven = table[commands].abs().max(axis=1).to_numpy(float)
        rest = table[driven <= np.nanquantile(driven, REST_SHARE)]
        return np.array([float(rest[t].median()) if t in table else 0.0 for t in TIPS])
    except (TypeError, ValueError):
        return None  # texts, which the rules refuse


def extent(recording: Recording) -> str:
    """`10 runs, 8.6 minutes, 20 Hz`."""
    seconds, steps = rules.recorded_s(recording.samples), recording.samples.groupby("trial")["time_s"].diff()
    rate = 1 / float(steps[steps > 0].median()) if (steps > 0).any() else 0.0
    rate = f", {rate:.0f} Hz" if rate >= 1000 else f", {rate:.3g} Hz" * bool(rate)
    minutes = f"{seconds / 60:.2g}" if seconds < 6000 else f"{seconds / 60:.0f}"
    length = f"{minutes} minutes" if seconds >= 60 else f"{seconds:.3g} s"
    return f"{plural(len(recording.trials()), 'run')}, {length}{rate}"
