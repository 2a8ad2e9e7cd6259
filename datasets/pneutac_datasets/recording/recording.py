"""A bench recording: measurements of one device, as a folder with `recording.json` and a table of samples.

Its files are read bounded in memory: CSV, Parquet, a LeRobotDataset.

It is cut into blocks of time, which are dealt into parts, stratified by condition. Neighbouring samples carry
nearly the same error, so a split by single samples would test a model on what it was fitted to; whole blocks
do not. Rare conditions (a flipped base in a tenth of the blocks) must be in each part, else their effect is
either not learned or not tested.
"""

import re
from collections.abc import Sequence, Sized
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import quote

import numpy as np
import pandas as pd

from pneutac_datasets.recording import rules
from pneutac_datasets.recording.rules import TrialStart, meta_of_trials
from pneutac_datasets.recording.text_table import MAX_COLUMNS, MAX_ROWS, read_text
from pneutac_datasets.recording.units import base_unit, unit_named
from pneutac_datasets.recording.wording import SourceFile, cut, listed
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import inside, meant, read_image, read_json, refuse_pointer, whole, write_json

TARGET_BLOCKS = 40
EDGE = 1e-5  # of a block: rows so near its end belong to the next
DIGITS = "%.7g"  # of the numbers in a written table
CLOCKS = ("time_s", "time_sent_s")  # which have digits of their own
GRAVITY = ("gravity_x", "gravity_y", "gravity_z")
MAX_CELLS = 200_000_000  # 1.6 GB of numbers: a small Parquet file may stand for far more
MAX_NAME = 255  # characters of a file's name
LEVELS = ("temperature_c", "payload_g")  # drift within a block, so a block counts with its mean


def time_blocks(samples: pd.DataFrame) -> np.ndarray:
    """Block number (n,) of each sample: equal pieces of time within one trial, program and orientation."""
    cut = np.zeros(len(samples), bool)
    cut[0] = True
    trial = samples["trial"].to_numpy()
    cut[1:] |= trial[1:] != trial[:-1]
    for name in ("program", *GRAVITY):
        if name not in samples:
            continue
        v = np.round(samples[name].to_numpy(float)) if name in GRAVITY else pd.factorize(samples[name])[0]
        change = v[1:] != v[:-1]
        if change.sum() <= len(samples) / 20:  # a label that flickers cannot bound blocks
            cut[1:] |= change
    run = np.cumsum(cut) - 1
    time = samples["time_s"].to_numpy()
    begin = np.flatnonzero(cut)
    end = np.r_[begin[1:], len(samples)]
    duration = time[end - 1] - time[begin]
    target = max(duration.sum() / TARGET_BLOCKS, 1e-9)
    # An offset of the clock changes the last digits of times: what is at an edge must not depend on them.
    pieces = np.maximum(1, np.round(np.round(duration / target, 6))).astype(int)
    # a short run (one step of a trial) still gives something to both parts
    pieces = np.where((pieces == 1) & (end - begin >= 20), 2, pieces)
    share = (time - time[begin][run]) / np.maximum(duration[run], 1e-12)
    within = np.minimum((share * pieces[run] + EDGE).astype(int), pieces[run] - 1)
    return np.unique(run * (pieces.max() + 1) + within, return_inverse=True)[1]


def strata(samples: pd.DataFrame, block: np.ndarray) -> np.ndarray:
    """Stratum number of each block (n_blocks,): equal program, orientation, level of temperature, load."""
    first = np.unique(block, return_index=True)[1]
    key = [np.zeros(len(first), int)]
    for name in ("program", "indenter", "role"):
        if name in samples:
            key.append(pd.factorize(samples[name].astype(str))[0][first])
    for name in GRAVITY:
        if name in samples:
            key.append(np.round(samples[name].to_numpy(float)[first]).astype(int))
    for name in LEVELS:
        if name in samples:
            v = samples[name].to_numpy(float)
            mean = np.bincount(block, v) / np.bincount(block)
            span = np.ptp(mean)
            key.append(np.minimum(2, (3 * (mean - mean.min()) / span).astype(int)) if span > 0 else key[0])
    return np.unique(np.stack(key, 1), axis=0, return_inverse=True)[1].reshape(-1)


def assign(
    samples: pd.DataFrame, block: np.ndarray, seed: int, fractions: tuple[float, ...] = (0.7, 0.3)
) -> np.ndarray:
    """Part number (n,) of each sample.

    Blocks are shuffled within their stratum and laid on one line; each part takes its share spread evenly
    along it, so a stratum with as many blocks as there are parts is in every part. Fractions are positive and
    sum to 1.
    """
    rng = np.random.default_rng(seed)
    share = np.asarray(fractions, float)
    share = share / share.sum()
    stratum = strata(samples, block)
    part = np.zeros(len(stratum), int)
    debt = np.zeros(len(share))  # what each part is owed; carried over so that single blocks are dealt fairly
    for s in rng.permutation(stratum.max() + 1):
        members = rng.permutation(np.flatnonzero(stratum == s))
        missing = set(range(len(share))) if len(members) >= len(share) else set()
        for left, b in zip(range(len(members), 0, -1), members, strict=True):
            debt += share
            options = list(missing) if len(missing) == left else range(len(share))
            part[b] = max(options, key=lambda i: debt[i])
            debt[part[b]] -= 1
            missing.discard(int(part[b]))
    if len(stratum) >= len(share):  # no part is empty where there are blocks enough
        for i in range(len(share)):
            if not (part == i).any():
                largest = np.bincount(part, minlength=len(share)).argmax()
                part[rng.choice(np.flatnonzero(part == largest))] = i
    return part[block]


@dataclass
class Recording:
    """Measurements of one device."""

    folder: Path  # where it was read from
    meta: dict  # the fields of `recording.json`
    samples: pd.DataFrame  # one row a sample, in time order within each trial, numbers as float64
    device: str  # `finger`, `arm` or `gel`
    warnings: list[str] = field(default_factory=list)  # one sentence for each thing that is poor but usable

    @classmethod
    def load(cls, path: str | Path) -> "Recording":
        """Reads a recording's folder, or a LeRobotDataset's root with the same columns as feature names.

        Raises InputError: one sentence with file, column, row (the first row of data is row 1) and remedy.
        """
        folder = Path(path)
        meta = read_meta(folder)
        for fault in rules.meta_faults(meta, folder / "recording.json"):
            raise InputError(fault)
        if not meta.get("lerobot"):
            rules.device_of(meta, pd.DataFrame(), folder)
        table, file = read_table(folder, meta)
        device = rules.device_of(meta, table, folder)
        samples, warnings = rules.check_samples(table, device, meta, file)
        return cls.of_rows(folder, meta, samples, device, warnings)

    @classmethod
    def of_rows(
        cls, folder: Path, meta: dict, samples: pd.DataFrame, device: str, warnings: list[str]
    ) -> "Recording":
        """Of samples that `rules.look` has cleaned, with what it warned of."""
        warnings = [*meta.get("conversion", {}).get("notes", []), *warnings]
        return cls(folder, meta, samples.reset_index(drop=True), device, warnings)

    def write(self, path: str | Path) -> Path:
        """Writes `recording.json` and the samples (CSV unless `meta` names a .parquet) into a folder."""
        path = Path(path)
        meta = {k: v for k, v in self.meta.items() if k != "lerobot"} | {"device": self.device}
        meta.setdefault("samples", "samples.csv")
        file = path / meta["samples"]
        with whole(file) as part:
            if file.suffix == ".parquet":
                self.samples.to_parquet(part, index=False)
            else:
                # nine decimals: seven digits would be too few for a clock that counts since 1970
                clocks = self.samples[[c for c in CLOCKS if self.has(c)]]
                times = clocks.map(lambda seconds: np.format_float_positional(seconds, 9, trim="-"))
                self.samples.assign(**times).to_csv(part, index=False, float_format=DIGITS)
        write_json(path / "recording.json", meta)
        return path

    def as_written(self) -> "Recording":
        """The recording with the digits that `write` gives to a CSV, so that both are judged alike."""
        numbers = self.samples.select_dtypes("float")
        rounded = {c: numbers[c].map(lambda x: float(DIGITS % x)) for c in numbers if c not in CLOCKS}
        return replace(self, samples=self.samples.assign(**rounded))

    # ---------------------------------------------------------------- what it holds

    @property
    def length_mm(self) -> float | None:
        """Length of the straight device, None if the recording does not state it."""
        return float(self.meta["length_mm"]) if self.meta.get("length_mm") is not None else None

    @property
    def spine_joint_positions_mm(self) -> list[float] | None:
        """Arc lengths of the spine joints, None if the recording does not state it."""
        joints = self.meta.get("spine_joint_positions_mm")
        return [float(x) for x in joints] if joints is not None else None

    def __len__(self) -> int:
        return len(self.samples)

    def has(self, column: str) -> bool:
        return column in self.samples.columns

    def column(self, name: str) -> np.ndarray:
        """One column as an array (n,); raises InputError where it is missing."""
        if name not in self.samples.columns:
            raise InputError(f"{self.folder}: column '{name}' is missing; it has {listed(self.samples)}.")
        return self.samples[name].to_numpy()

    @property
    def observations(self) -> list[str]:
        """Columns that a model of the device predicts (markers, angles, curvatures, images)."""
        return rules.observations(self.samples, self.device)

    @property
    def poses(self) -> list[str]:
        """Columns of observations but images."""
        return [c for c in self.observations if not c.startswith("image")]

    @property
    def pressure_columns(self) -> list[str]:
        """Commanded pressure, one column a chamber."""
        return rules.pressure_commands(self.samples)

    @property
    def commands(self) -> np.ndarray:
        """Commanded pressures (n, chambers), kPa."""
        return self.samples[self.pressure_columns].to_numpy(float)

    @property
    def pressures(self) -> np.ndarray:
        """Pressures (n, chambers), kPa, measured where all of them were logged."""
        measured = [c.replace("cmd_", "") for c in self.pressure_columns]
        return self.samples[measured].to_numpy(float) if all(map(self.has, measured)) else self.commands

    @property
    def conditions(self) -> list[str]:
        """All other columns: under which circumstances a sample was taken."""
        known = {"trial", "time_s", "time_sent_s", *self.observations, *self.pressure_columns}
        return [c for c in self.samples if c not in known and not re.fullmatch(r"(image|mask)(_\w+)?", c)]

    def trials(self) -> dict[int, slice]:
        """Trial number to its rows, in order."""
        trial = self.samples["trial"].to_numpy()
        edges = np.r_[0, np.flatnonzero(trial[1:] != trial[:-1]) + 1, len(trial)]
        return {int(trial[a]): slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)}

    @property
    def step_s(self) -> float:
        """Usual time between two rows of a trial, s; 0 where each trial has one."""
        time = self.column("time_s")
        steps = np.concatenate([np.diff(time[rows]) for rows in self.trials().values()])
        return float(np.median(steps)) if len(steps) else 0.0

    @property
    def starts(self) -> dict[int, TrialStart]:
        """Trial number to how it began, in order; `unknown` where it is not stated."""
        stated = self.meta.get("trials") or {}
        return {trial: TrialStart(**stated.get(str(trial), {})) for trial in self.trials()}

    def image(self, value, plain: bool = False) -> np.ndarray:
        """RGB uint8 (H, W, 3) named in a column: a relative path, or bytes stored in Parquet.

        With `plain` a file must be RGB with 8 bits a channel.
        """
        if isinstance(value, dict) and value.get("bytes"):
            return read_image(value["bytes"], f"{self.folder}: an image of the dataset")
        if not isinstance(value, (str, dict)):
            raise InputError(f"{self.folder}: a row names no image (or mask) where one is needed.")
        name = str(value.get("path") if isinstance(value, dict) else value)
        if len(name) > MAX_NAME or "\0" in name:
            raise InputError(f"{self.folder}: image {shown(name)} is no file's name; give its file.")
        source = self.folder / name
        if not inside(self.folder, source):
            inner = name.lstrip("/")
            hint = f"; name it '{inner}'" if (self.folder / inner).is_file() else ""
            raise InputError(f"{self.folder}: image '{name}' lies outside the recording's folder{hint}.")
        if not source.is_file():
            raise InputError(f"{source} is missing, though the recording names it as an image.")
        return read_image(source, plain=plain)

    def keep(self, rows: np.ndarray) -> "Recording":
        """The same recording with only the rows where the mask (n,) is true."""
        samples = self.samples[np.asarray(rows, bool)].reset_index(drop=True)
        meta = meta_of_trials(self.meta, list(self.trials()), [int(t) for t in samples["trial"].unique()])
        return Recording(self.folder, meta, samples, self.device, list(self.warnings))

    # ---------------------------------------------------------------- train and held-out parts

    def blocks(self) -> np.ndarray:
        """Block number of each sample (n,): pieces of time inside one trial, program and orientation."""
        return time_blocks(self.samples)

    def split(self, seed: int = 0, fractions: tuple[float, ...] = (0.7, 0.3)) -> tuple[np.ndarray, ...]:
        """Masks (n,) of parts by whole blocks of time, stratified by program, orientation and conditions.

        A gel is split by role instead where it has one: `calibration` trains, everything else is held out.
        Three fractions make train, validation and an untouched test part.
        """
        if self.device == "gel" and self.has("role") and len(fractions) == 2:
            train = (self.samples["role"] == "calibration").to_numpy()
            if train.any():
                return train, ~train
        part = assign(self.samples, self.blocks(), seed, fractions)
        return tuple(part == i for i in range(len(fractions)))


def joined(recordings: Sequence[Recording], pauses_s: Sequence[float | None]) -> Recording:
    """All trials of several recordings of one device in their order, renumbered.

    `pauses_s` are the seconds without pressure before each recording, since the one before it; None where its
    first trial begins as its own `recording.json` says, or at an unknown state. Raises InputError where they
    differ in device, length or columns.
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


def wide_gaps(time_s: np.ndarray) -> tuple[float, np.ndarray]:
    """The usual step (s) of a trial's clock (n,), and whether each step (n - 1,) is a pause of it.

    Shorter ones, above the usual step, are rows that are missing.
    """
    dt = np.diff(time_s)
    usual = float(np.median(dt)) if len(dt) else 0.0
    return usual, dt > max(10 * usual, 0.5)


def count_left_out(trial: np.ndarray, time_s: np.ndarray, seen: np.ndarray) -> int:
    """How many of the rows (n,) that a conversion leaves out, as not `seen`, will miss from an even clock."""
    count = 0
    for rows in (np.flatnonzero(seen & (trial == t)) for t in np.unique(trial)):
        count += int((np.diff(rows) - 1)[~wide_gaps(time_s[rows])[1]].sum())
    return count


def read_meta(folder: Path) -> dict:
    """Reads `recording.json` of a folder, or makes the equivalent for a LeRobotDataset without one."""
    file = folder / "recording.json"
    if not folder.is_dir():
        near = meant(folder, "recording.json") or "give a folder that holds recording.json."
        raise InputError(f"There is no bench recording at '{folder}'; {near}")
    if not file.is_file():
        if (folder / "meta" / "info.json").is_file():
            return {"lerobot": True}
        tables = [p for ending in (".csv", ".tsv", ".mat") for p in sorted(folder.glob(f"*{ending}"))]
        if (folder / "twin.yaml").is_file():
            remedy = f"'{folder}' is a twin"
        elif tables and not (folder / "samples.csv").is_file():
            pattern = quote(str(folder / f"*{tables[0].suffix}"))
            remedy = f"'{folder}' holds tables: give one, such as '{tables[0]}', or all by {pattern}"
        else:
            remedy = "a bench recording is a folder with recording.json and samples.csv"
        raise InputError(f"{file} is missing; {remedy}.")
    meta = read_json(file)
    if (folder / "meta" / "info.json").is_file() and "samples" not in meta:
        meta["lerobot"] = True
    return meta


def read_table(folder: Path, meta: dict) -> tuple[pd.DataFrame, Path]:
    """Reads the samples; returns them and the file they came from.

    Raises InputError: the file is missing, larger than the limits above, or not a table.
    """
    if meta.get("lerobot"):
        return _read_lerobot(folder), folder / "data"
    name, field = meta.get("samples", "samples.csv"), f"{folder / 'recording.json'}: field 'samples'"
    named = isinstance(name, str) and len(name) <= MAX_NAME
    if not named or Path(name).suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{field} is {shown(name)}; name a .csv or .parquet file.")
    file = folder / name
    if not inside(folder, file):
        raise InputError(f"{field} must name a file inside the folder.")
    if not file.is_file():
        raise InputError(f"{file} is missing; field 'samples' of recording.json names the table of samples.")
    if file.suffix.lower() != ".csv":
        return read_parquet(file), file
    table, source = read_text(file), SourceFile(file)
    source.lines = table.lines
    for name, unit in table.units.items():
        own, found = base_unit(name), unit_named(unit)
        if own and found and (found.against == "abs" or found.scale != own.scale):
            said = f"column {shown(name)} is in {shown(unit)}, as a line below the header or its cells say"
            raise InputError(f"{file}: {said}; `pneutac convert {quote(str(file))}` converts it.")
    return table.frame, source


def read_parquet(file: Path) -> pd.DataFrame:
    """A table of Parquet, bounded in rows and columns; raises InputError where it is damaged."""
    import pyarrow as pa  # which recordings as CSV do without
    import pyarrow.parquet as pq

    refuse_pointer(file)
    try:
        found = pq.ParquetFile(file).metadata
        rows = found.num_rows
        if rows > MAX_ROWS:
            raise InputError(f"{file} has {rows} rows, above the limit of {MAX_ROWS}; keep every n-th row.")
        if found.num_columns > MAX_COLUMNS or rows * found.num_columns > MAX_CELLS:
            raise InputError(f"{file} has {found.num_columns} columns of {rows} rows; keep every n-th row.")
        return pq.read_table(file).to_pandas()
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError, IndexError) as e:  # damaged footers
        reason = cut((str(e).splitlines() or [type(e).__name__])[0]).rstrip(".")
        raise InputError(f"{file} cannot be read as Parquet: {reason}.") from e


def _read_lerobot(folder: Path) -> pd.DataFrame:
    """Columns of a LeRobotDataset: scalar features by name, vector features by the names of their entries.

    `episode_index` becomes `trial` and `timestamp` becomes `time_s` where those are not features themselves.
    """
    file = folder / "meta" / "info.json"
    features = read_json(file).get("features")
    if not isinstance(features, dict):
        raise InputError(f"{file}: field 'features' is {shown(features)}; the LeRobotDataset is damaged.")
    data = folder / "data"
    parts = sorted(data.glob("**/*.parquet"))
    if not parts:
        raise InputError(f"{data} holds no .parquet file; the LeRobotDataset is empty or incomplete.")
    raw = pd.concat([read_parquet(p) for p in parts], ignore_index=True)
    if len(raw) > MAX_ROWS:
        raise InputError(f"{folder} has {len(raw)} rows, above the limit of {MAX_ROWS}; use fewer episodes.")
    columns: dict[str, pd.Series] = {}
    source: dict[str, str] = {}
    for name, feature in features.items():
        if name not in raw.columns:  # as videos, which are separate files
            continue
        names = feature.get("names") if isinstance(feature, dict) else None
        names = list(names.values())[0] if isinstance(names, dict) and names else names
        first = raw[name].iloc[0] if len(raw) else None
        vector = isinstance(first, Sized) and not isinstance(first, str | dict | bytes)
        size, entries = len(first) if vector and isinstance(first, Sized) else 0, [name]
        if vector and isinstance(names, list) and len(names) == size:
            entries = [str(n) for n in names]  # a vector of one entry may have a name, too
        elif vector and size != 1:
            continue
        for i, entry in enumerate(entries):
            if entry in columns:
                raise InputError(
                    f"{file}: {shown(entry)} is the name of an entry of {shown(source[entry])} and of"
                    f" {shown(name)}; give each its own name."
                )
            columns[entry] = raw[name].map(lambda v, i=i: v[i]) if vector else raw[name]
            source[entry] = name
    for old, new in (("episode_index", "trial"), ("timestamp", "time_s")):
        if new not in columns and old in columns:
            columns[new] = columns.pop(old)
    return pd.DataFrame({c: v for c, v in columns.items() if c not in ("frame_index", "index", "task_index")})
