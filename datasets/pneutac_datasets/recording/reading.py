"""Reads the table of a bench recording from CSV, Parquet or a LeRobotDataset, bounded in memory."""

import json
import re
from collections.abc import Iterator, Sized
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pneutac_datasets.recording.wording import cut, shown
from pneutac_sim.errors import CONTROL, InputError
from pneutac_sim.files import inside

# A bench run of one hour at 100 Hz with 20 columns is about 60 MB of text; far above that, reading a table
# whole would fill a laptop's memory (pandas needs roughly three times the size of the file).
MAX_CSV_BYTES = 300 * 2**20
MAX_ROWS = 5_000_000
MAX_CELLS = 200_000_000  # 1.6 GB of numbers: a small Parquet file may stand for far more
MAX_COLUMNS = 1000
MAX_META_BYTES = 2**22
MAX_NAME = 255  # characters of a file's name


def read_meta(folder: Path) -> dict:
    """Reads `recording.json` of a folder, or makes the equivalent for a LeRobotDataset without one."""
    file = folder / "recording.json"
    if not folder.is_dir():
        raise InputError(
            f"There is no bench recording at '{folder}'; give a folder that holds recording.json."
        )
    if not file.is_file():
        if (folder / "meta" / "info.json").is_file():
            return {"lerobot": True}
        raise InputError(
            f"{file} is missing; a bench recording is a folder with recording.json and samples.csv."
        )
    try:
        if file.stat().st_size > MAX_META_BYTES:
            raise InputError(f"{file} is larger than {MAX_META_BYTES} bytes; samples belong into a table.")
        meta = json.loads(file.read_text(encoding="utf-8"), parse_int=_whole)
        if any(CONTROL.search(text) for text in _texts(meta)):
            raise InputError(f"{file} holds control characters; correct it in a text editor.")
    except InputError:
        raise
    except (ValueError, RecursionError) as e:
        raise InputError(f"{file} is not valid JSON: {cut(str(e))}; correct it in a text editor.") from e
    if not isinstance(meta, dict):
        raise InputError(f"{file} must hold a JSON object with the fields device, length_mm and samples.")
    if (folder / "meta" / "info.json").is_file() and "samples" not in meta:
        meta["lerobot"] = True
    return meta


def _whole(digits: str) -> int | float:
    """A whole number of JSON; one that no measurement has is infinite, which every field refuses."""
    return int(digits) if len(digits) < 20 else float(digits)


def _texts(content) -> Iterator[str]:
    """All names and texts of what JSON holds."""
    if isinstance(content, str):
        yield content
    elif isinstance(content, list):
        for value in content:
            yield from _texts(value)
    elif isinstance(content, dict):
        yield from content
        yield from _texts(list(content.values()))


def read_table(folder: Path, meta: dict) -> tuple[pd.DataFrame, Path]:
    """Reads the samples; returns them and the file they came from.

    Raises:
        InputError: the file is missing, larger than the limits above, or not a table.
    """
    if meta.get("lerobot"):
        return _read_lerobot(folder), folder / "data"
    name = meta.get("samples", "samples.csv")
    if (
        not isinstance(name, str)
        or len(name) > MAX_NAME
        or Path(name).suffix.lower() not in (".csv", ".parquet")
    ):
        raise InputError(
            f"{folder / 'recording.json'}: field 'samples' is {shown(name)}; name a .csv or .parquet file."
        )
    file = folder / name
    if not inside(folder, file):
        raise InputError(f"{folder / 'recording.json'}: field 'samples' must name a file inside the folder.")
    if not file.is_file():
        raise InputError(f"{file} is missing; field 'samples' of recording.json names the table of samples.")
    return (read_csv(file) if file.suffix.lower() == ".csv" else _read_parquet(file)), file


def read_csv(file: Path) -> pd.DataFrame:
    """A table of text with commas, semicolons or tabs; raises InputError where it is none or too large."""
    size = file.stat().st_size
    if size > MAX_CSV_BYTES:
        raise InputError(
            f"{file} has {size / 2**30:.1f} GB, above the limit of {MAX_CSV_BYTES // 2**20} MB for text; "
            "keep every n-th row (20 to 50 Hz is enough) or convert it to .parquet."
        )
    try:
        encoding = _encoding(file)
        with file.open(encoding=encoding) as f:
            line, rows = f.readline().strip("\n\r"), f.readline()
        mark = next((m for m in (",", ";", "\t") if m in line), ",")
        # A spreadsheet that writes decimal commas puts something else between the columns.
        decimal = "," if mark != "," and re.search(r"\d,\d", rows) else "."
        header = [c.strip() for c in line.split(mark)]
        doubled = sorted({c for c in header if header.count(c) > 1})
        if doubled:
            raise InputError(
                f"{file}: column {shown(doubled[0])} appears twice in the header; keep one of them."
            )
        if len(header) > MAX_COLUMNS:
            raise InputError(f"{file} has {len(header)} columns, above the limit of {MAX_COLUMNS}.")
        options = {"sep": mark, "decimal": decimal, "encoding": encoding, "skipinitialspace": mark != "\t"}
        table = pd.read_csv(file, low_memory=False, nrows=MAX_ROWS + 1, **options)
        if len(table) > MAX_ROWS:
            raise InputError(f"{file} has over {MAX_ROWS} rows; keep every n-th row.")
        return table.rename(columns=str.strip)
    except UnicodeError as e:
        raise InputError(
            f"{file} is not UTF-8 text ({getattr(e, 'reason', e)}); save it as plain CSV."
        ) from e
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as e:
        reason = cut(str(e).strip().splitlines()[0])
        raise InputError(f"{file} is not a comma-separated table: {reason}; save it as plain CSV.") from e


def _encoding(file: Path) -> str:
    """UTF-8, or UTF-16 as spreadsheets write it, by the mark at the beginning of the file."""
    with file.open("rb") as f:
        return "utf-16" if f.read(2) in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"


def _read_parquet(file: Path) -> pd.DataFrame:
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
        reason = cut((str(e).splitlines() or [type(e).__name__])[0])
        raise InputError(f"{file} cannot be read as Parquet: {reason}.") from e


def _read_lerobot(folder: Path) -> pd.DataFrame:
    """Columns of a LeRobotDataset: scalar features by name, vector features by the names of their entries.

    `episode_index` becomes `trial` and `timestamp` becomes `time_s` where those are not features themselves.
    """
    file = folder / "meta" / "info.json"
    try:
        features = json.loads(file.read_text(encoding="utf-8"))["features"]
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"{file} is not a LeRobotDataset's info.json: {cut(repr(e))}.") from e
    parts = sorted((folder / "data").glob("**/*.parquet"))
    if not parts:
        raise InputError(
            f"{folder / 'data'} holds no .parquet file; the LeRobotDataset is empty or incomplete."
        )
    raw = pd.concat([_read_parquet(p) for p in parts], ignore_index=True)
    if len(raw) > MAX_ROWS:
        raise InputError(f"{folder} has {len(raw)} rows, above the limit of {MAX_ROWS}; use fewer episodes.")
    columns: dict[str, pd.Series] = {}
    for name, feature in features.items():
        if name not in raw.columns:
            continue  # videos are files apart, not columns
        names = feature.get("names")
        names = list(names.values())[0] if isinstance(names, dict) else names
        first = raw[name].iloc[0] if len(raw) else None
        if isinstance(first, Sized) and not isinstance(first, str | dict):
            if not isinstance(names, list) or len(names) != len(first):
                if len(first) != 1:
                    continue
                names = [name]  # LeRobot keeps a number as a vector of one entry
            for i, entry in enumerate(names):
                columns[str(entry)] = raw[name].map(lambda v, i=i: v[i])
        else:
            columns[name] = raw[name]
    table = pd.DataFrame(columns)
    table = table.rename(
        columns={
            old: new
            for old, new in (("episode_index", "trial"), ("timestamp", "time_s"))
            if new not in table.columns
        }
    )
    return table.drop(columns=[c for c in ("frame_index", "index", "task_index") if c in table.columns])
