"""Reads the files of a bench recording, bounded in memory: CSV, Parquet, a LeRobotDataset, images."""

from collections.abc import Sized
from pathlib import Path
from shlex import quote

import pandas as pd

from pneutac_datasets.recording.text_table import MAX_COLUMNS, MAX_ROWS, read_text
from pneutac_datasets.recording.units import base_unit, unit_named
from pneutac_datasets.recording.wording import SourceFile, cut
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import inside, meant, read_json, refuse_pointer

MAX_CELLS = 200_000_000  # 1.6 GB of numbers: a small Parquet file may stand for far more
MAX_NAME = 255  # characters of a file's name


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
