"""Tables of text as labs and spreadsheets write them: any delimiter, decimal mark, encoding and preamble."""

import csv
import re
import warnings
from dataclasses import dataclass, field
from itertools import accumulate, islice
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.units import unit_named
from pneutac_datasets.recording.wording import cut
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import refuse_pointer

# A bench run of one hour at 100 Hz with 20 columns is about 60 MB of text; far above that, reading a table
# whole would fill a laptop's memory (pandas needs roughly three times the size of the file).
MAX_CSV_BYTES = 300 * 2**20
MAX_ROWS = 5_000_000
MAX_COLUMNS = 1000
HEAD_LINES = 400  # by which delimiter, header and decimal mark are recognised
LONGEST_LINE = 2**17
DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", " ": "blanks"}
COMMENT = re.compile(r"\s*(#|%|//)")
MORE = ["\0more", "\0more2", "\0more3"]  # fields beyond the header, mostly empty
EMPTY = ["--", "---", "-", "n/a", "#NV", "#WERT!", "#VALUE!", "#DIV/0!", "#REF!", "?"]
# How files begin that are no text though their names may say so.
KINDS = {
    b"PK\x03\x04": "a spreadsheet or an archive",
    b"\xd0\xcf\x11\xe0": "a spreadsheet",
    b"\x89HDF": "an HDF5 file",
    b"PAR1": "a Parquet file",
    b"MATLAB 5": "a .mat file",
    b"%PDF-": "a PDF",
    b"<": "a web page or XML",
}
NUMBER = re.compile(
    r"\s*[-+\u2212]?(\d[\d.,]*|\d{1,3}([\s'\u2019\u00a0\u202f]\d{3})+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?\s*"
)
WITH_UNIT = re.compile(rf"({NUMBER.pattern})([^\d\s.,+-][^\d]{{0,8}})")
TIME_OF_DAY = re.compile(r"(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T\s]?)?\d{1,2}:\d{2}(:\d{2})?([.,]\d+)?.*")
SUFFIXES = "png jpg jpeg bmp tif tiff stl obj ply mp4 avi".split()  # `7.png` and `7_mask.png` are files
HUGE = re.compile(r"[\d.,]\s*[eE][-+]?\d{4,}")  # pandas 2.3 reads beyond its memory at long exponents
GROUPS_OF_THREE = re.compile(r"\s*[-+\u2212]?[1-9]\d{0,2}([.,]\d{3})+\s*")


@dataclass
class TextTable:
    """A table of text."""

    file: Path  # where it was read from
    frame: pd.DataFrame  # a column by its name: numbers where all of its cells are, else texts
    # of each column, from a row below the header or behind every number; empty where there is none
    units: dict[str, str]
    lines: np.ndarray  # line of the file (n,) in which each row stands
    style: str = ""  # `semicolons, decimal commas`
    notes: list[str] = field(default_factory=list)  # a sentence for each thing that was left out


def read_text(file: Path) -> TextTable:
    """A table of text with a header.

    Lines that begin with `#`, `%` or `//`, lines above the header, empty lines and lines below the last
    number are left out. `sep=;` in the first line names the delimiter, as spreadsheets do.

    Raises InputError: it is no table, has no header, or is too large.
    """
    try:
        size = file.stat().st_size
        file.open("rb").close()
    except OSError as e:
        raise InputError(f"{file} cannot be read: {e.strerror or e}.") from e
    if size > MAX_CSV_BYTES:
        raise InputError(
            f"{file} has {size / 2**30:.1f} GB, above the limit of {MAX_CSV_BYTES // 2**20} MB for text; "
            "keep every n-th row (20 to 50 Hz is enough) or convert it to .parquet."
        )
    encoding = _encoding(file)
    try:
        with file.open(encoding=encoding) as f:
            head = [line.rstrip("\n\r")[:LONGEST_LINE] for line in islice(f, HEAD_LINES)]
        return _read(file, encoding, head)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeError, csv.Error, OverflowError) as e:
        reason = (str(e).strip().splitlines() or [type(e).__name__])[0]
        fields = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", reason)
        if fields:
            raise InputError(
                f"{file}, line {fields[2]}, has {fields[3]} fields where the others have {fields[1]}; correct"
                " that line, or put texts that hold the delimiter in quotes."
            ) from e
        raise InputError(f"{file} cannot be read as a table of text: {cut(reason)}.") from e


def _read(file: Path, encoding: str, head: list[str]) -> TextTable:
    named = re.fullmatch(r'\s*"?sep=(.|\\t)"?\s*', head[0], re.I) if head else None
    given = None if named is None else "\t" if named[1] in ("\\t", "\t") else named[1]
    used = {i for i, line in enumerate(head) if line.strip(' ";,\t|')} - ({0} if named else set())
    comments = {i for i in used if COMMENT.match(head[i])}
    body = sorted(used - comments)
    if not body:
        raise InputError(f"{file} holds no table; give a CSV with a header and a row for each sample.")
    mark = given or _delimiter([head[i] for i in body])
    cells = {i: _cells(head[i], mark) for i in body}
    typical = _median([_count(cells[i]) for i in body[len(body) // 2 :]])
    numeric = [i for i in body if _count(cells[i])] or [*body[1:2], len(head)]  # else words in all rows
    first = next((i for i in body if typical and _count(cells[i]) >= max(1, 0.6 * typical)), numeric[0])
    above = [i for i in body if i < first]
    width = len(cells[first]) if first in cells else len(cells[above[-1]])
    lead = max(comments & set(range(first)), default=None)
    if not above and lead is not None:  # `numpy.savetxt` writes the header as a comment
        cells[lead] = _cells(COMMENT.sub("", head[lead], count=1), mark)
        above = [lead] if len(cells[lead]) == width else []
    if not above:
        example = (mark if mark != " " else ",").join(("time [s]", "p_set [kPa]", "x [mm]", "z [mm]"))
        raise InputError(
            f"{file}: line {first + 1} holds numbers where the names of the columns should be; write a line"
            f" above it such as {example}"
        )
    at, units_row = above[-1], None
    if len(above) > 1 and _are_units(cells[at]) and len(cells[above[-2]]) >= len(cells[at]) > 0:
        at, units_row = above[-2], at
    names, over = [c.strip() for c in cells[at]], above[: above.index(at)][-1:]
    if over and len(cells[over[0]]) == len(names) and len(set(filter(None, names))) < sum(map(bool, names)):
        # axes alone stand in the header: `Tip`, `` and below it `x`, `y`
        groups = accumulate(cells[over[0]], lambda last, group: group or last)
        names = [f"{group} {name}".strip() for group, name in zip(groups, names, strict=True)]
    while names and not names[-1] and len(names) > width:
        names.pop()
    typical_width = _median([len(cells[i]) for i in body if i >= first] or [len(names)])
    crowded = _median([sum(map(bool, cells[i])) for i in body if i >= first]) > len(names)
    pointless = not any("." in head[i] for i in body if i >= first)
    if mark == "," and (len(names) != width and typical_width == 2 * len(names) or crowded and pointless):
        raise InputError(
            f"{file} has {len(names)} names in its header and {typical_width} fields in its rows: decimal"
            " commas between commas; save it with semicolons between the columns, or with decimal points."
        )
    if len(names) > MAX_COLUMNS:
        raise InputError(f"{file} has {len(names)} columns, above the limit of {MAX_COLUMNS}.")
    doubled = sorted({c for c in names if c and names.count(c) > 1})
    if doubled:
        raise InputError(
            f"{file}: column {shown(doubled[0])} appears twice in the header; give each column its own name."
        )
    columns = [n or f"\0{i}" for i, n in enumerate(names)]  # nothing of a file has such a name
    begin = (units_row if units_row is not None else at) + 1
    comma = mark != "," and any(
        _definite(c) == "," for i in body if i >= first for c in cells[i] if NUMBER.fullmatch(c)
    )
    with warnings.catch_warnings():  # of more fields than names, which `_shape` refuses
        warnings.simplefilter("ignore", pd.errors.ParserWarning)
        frame = pd.read_csv(
            file, sep=r"\s+" if mark == " " else mark, decimal="," if comma else ".", encoding=encoding,
            header=None, names=[*columns, *MORE], index_col=False, skiprows=begin, skip_blank_lines=False,
            skipinitialspace=mark != "\t", na_values=EMPTY, low_memory=False, nrows=MAX_ROWS + 1,
            on_bad_lines="error", encoding_errors="strict",
        )  # fmt: skip
    if len(frame) > MAX_ROWS:
        raise InputError(f"{file} has over {MAX_ROWS} rows; keep every n-th row.")
    behind = () if units_row is None else cells[units_row]
    found = [u.strip("[](){} ") for u in behind]
    units = {c: u for c, u in zip(columns, found, strict=False) if u}
    table = TextTable(file, frame, units, np.arange(len(frame)) + begin + 1)
    _shape(table, names, mark)
    decimal = _texts_to_numbers(table, mark, comma)
    _cut_ends(table)
    table.style = DELIMITERS.get(mark, f"'{mark}'") + (", decimal commas" if decimal == "," else "")
    return table


def _shape(table: TextTable, names: list[str], mark: str) -> None:
    """Drops empty rows, comments and columns without name or content."""
    frame, file = table.frame, table.file
    keep = frame.notna().any(axis=1)
    if len(frame.columns) and frame.dtypes.iloc[0].kind == "O":
        first = frame.iloc[:, 0]
        keep &= ~first.map(lambda c: isinstance(c, str) and bool(COMMENT.match(c)))
    table.frame, table.lines = frame[keep].reset_index(drop=True), table.lines[keep.to_numpy()]
    for name in [c for c in table.frame if c.startswith("\0")]:
        filled = table.frame[name].notna()
        numbers = pd.to_numeric(table.frame[name], errors="coerce")
        if name[1:] == "0" and len(numbers) > 1 and (numbers.diff()[1:] == 1).all():  # as pandas writes them
            which = "column 1, which has no name and counts the rows,"
            table.notes.append(f"{file}: {which} is left out.")
        elif filled.any():
            line = table.lines[int(filled.argmax())]
            what = (
                f"line {line} has more fields than the header has names ({len(names)})"
                if name in MORE
                else f"column {int(name[1:]) + 1} has no name in the header but is filled in line {line}"
            )
            raise InputError(f"{file}: {what}; give every column a name.")
        table.frame = table.frame.drop(columns=name)
        table.units.pop(name, None)


def _texts_to_numbers(table: TextTable, mark: str, comma: bool) -> str:
    """Makes numbers of columns whose texts are: thousands marks, units behind them, another decimal mark."""
    frame = table.frame
    texts = {c: frame[c].dropna().astype(str) for c in frame if frame[c].dtype == object}
    points = not comma and any(
        frame[c].dtype == float and (frame[c].dropna() % 1 != 0).any() for c in frame if c not in texts
    )
    decimal = "," if comma else "."
    for name, values in texts.items():
        stripped = values
        matched = values.str.fullmatch(NUMBER.pattern)
        if len(values) and not matched.all():
            units = values.str.extract(rf"^{WITH_UNIT.pattern}$")
            behind = units[units.columns[-1]].dropna().str.strip().unique()
            unit = len(behind) == 1 and behind[0].lower().rpartition(".")[2] not in SUFFIXES
            if units.iloc[:, 0].notna().all() and unit and name not in table.units:
                table.units[name], stripped = behind[0], units.iloc[:, 0]
                matched = stripped.notna()
        if not len(values) or matched.mean() <= 0.5:
            continue
        marks = {m for m in map(_definite, stripped[matched].unique()) if m}
        if len(marks) > 1:
            row = next(i for i in stripped[matched].index if _definite(stripped[i]) == sorted(marks)[1])
            raise InputError(
                f"{table.file}: column {shown(name)} has decimal points and decimal commas, as in line"
                f" {table.lines[row]} ({shown(stripped[row])}); save it with one of them."
            )
        own = next(iter(marks), None)
        if own is None and stripped[matched].str.contains(",").any():
            # Groups of three digits alone: where other columns have points they are thousands.
            own = "." if points else "," if mark != "," or comma else None
            if own is None:
                row = stripped[matched].str.contains(",").idxmax()
                raise InputError(
                    f"{table.file}: column {shown(name)}, line {table.lines[row]} is {shown(stripped[row])},"
                    " with a decimal comma or a thousands mark; save it with decimal points and without"
                    " thousands marks."
                )
        own = own or decimal
        if own == ",":
            decimal = ","
        numbers = stripped.str.replace("\u2212", "-").str.replace(r"[\s'\u2019\u00a0\u202f]", "", regex=True)
        numbers = numbers.str.replace("." if own == "," else ",", "").str.replace(",", ".")
        numbers = pd.to_numeric(numbers.where(matched), errors="coerce")
        if numbers.notna().all():
            frame[name] = numbers.reindex(frame.index).astype(float)
        else:  # what is no number stays as it is, for the sentence that names it
            frame[name] = frame[name].where(~frame.index.isin(numbers.dropna().index), numbers)
    return decimal


def _cut_ends(table: TextTable) -> None:
    """Leaves out lines below the last number; raises InputError where a header stands between numbers."""
    frame = table.frame
    mixed = [c for c in frame if frame[c].dtype == object]
    if not len(frame) or not mixed:
        return
    texts = frame[mixed].map(lambda c: isinstance(c, str))
    numbers = frame.notna() & ~texts.reindex(columns=frame.columns, fill_value=False)
    hollow = ~numbers.any(axis=1)
    if hollow.all():
        return
    last = int(np.flatnonzero(~hollow)[-1])
    repeated = hollow & (frame[mixed].astype(str) == np.array(mixed)).all(axis=1)
    repeated[last:] = False
    if repeated.any():
        raise InputError(
            f"{table.file}: line {table.lines[int(repeated.argmax())]} repeats the header; put each run into"
            " a file of its own ('runs/*.csv' names them all), or number the runs in a column 'run'."
        )
    if last + 1 < len(frame):
        line, text = table.lines[last + 1], frame[mixed].iloc[last + 1].dropna().astype(str)
        table.notes.append(
            f"{table.file}: line {line} ({cut(', '.join(text), 40)}) and what follows holds no number and is"
            " left out."
        )
        table.frame, table.lines = frame.iloc[: last + 1].copy(), table.lines[: last + 1]
    for c in mixed:
        values = pd.to_numeric(table.frame[c], errors="coerce")
        if values.notna().sum() == table.frame[c].notna().sum() and values.notna().any():
            table.frame[c] = values.astype(float)


def _encoding(file: Path) -> str:
    """By the mark at the beginning of the file, its zeros, or what decodes; one sentence where it is none."""
    refuse_pointer(file)
    with file.open("rb") as f:
        begin = f.read(4096)
    kind = next((k for mark, k in KINDS.items() if begin.startswith(mark)), None)
    if kind:
        raise InputError(f"{file} is {kind} and no text; save the table as 'CSV UTF-8' and give that.")
    if begin[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return _tried(file, "utf-16")
    zeros = begin.count(b"\0")
    if zeros > len(begin) / 4:  # UTF-16 without its mark
        return _tried(file, "utf-16-le" if begin[1::2].count(b"\0") > zeros / 2 else "utf-16-be")
    try:
        return _tried(file, "utf-8-sig")
    except InputError:
        if zeros:
            raise
        return _tried(file, "cp1252")  # a spreadsheet's in western Europe


def _tried(file: Path, encoding: str) -> str:
    before = ""
    try:
        with file.open(encoding=encoding) as f:
            while text := f.read(2**20):
                if "\0" in text:
                    raise InputError(f"{file} holds zero bytes, so it is no text; save it as 'CSV UTF-8'.")
                if huge := HUGE.search(before + text):
                    raise InputError(
                        f"{file} holds {shown(huge[0])}, a number beyond all limits; correct it, or leave out"
                        " that column."
                    )
                before = text[-64:]
    except UnicodeError as e:
        reason = getattr(e, "reason", e)
        raise InputError(f"{file} is no text that can be decoded ({reason}); save it as 'CSV UTF-8'.") from e
    return encoding


def _delimiter(lines: list[str]) -> str:
    """What stands between the columns: what makes most cells numbers, the same count in each line."""
    best, chosen = 0.0, ""
    for mark in DELIMITERS:
        every = [_cells(line, mark) for line in lines]
        rows = every[len(lines) // 2 :]
        width = _median([len(r) for r in rows])
        if width < 2:
            continue
        regular = [r for r in rows if len(r) == width]
        filled = [c for r in regular for c in r if c.strip()]
        numbers = sum(map(_is_number, filled)) / max(len(filled), 1)
        header = any(len(r) == width and 2 * _count(r) < width for r in every[: len(every) // 2 + 1])
        score = round(len(regular) / len(rows) * (0.05 + numbers) * (1.0 if header else 0.5), 2)
        if score > best:
            best, chosen = score, mark
    return chosen or ","


def _cells(line: str, mark: str) -> list[str]:
    if mark == " ":
        words = r'"[^"]*"|[^\s\[({]*[\[({][^\])}]*[\])}]|\S+(?:\s+\[[^\]]*\])?'
        return [c.strip('"') for c in re.findall(words, line)]
    try:
        return [c.strip() for c in next(csv.reader([line], delimiter=mark, skipinitialspace=True))]
    except (csv.Error, StopIteration):
        return line.split(mark)


def _count(cells: list[str]) -> int:
    """Numbers among cells; a time of day is one too."""
    return sum(_is_number(c) or bool(TIME_OF_DAY.fullmatch(c)) for c in cells)


def _is_number(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell) or WITH_UNIT.fullmatch(cell))


def _definite(text: str) -> str | None:
    """Which mark is the decimal one in a number, where that is certain."""
    marks = [c for c in text if c in ".,"]
    if not marks:
        return None
    if len(set(marks)) == 2:
        return marks[-1]
    if len(marks) > 1:
        return "," if marks[0] == "." else "."  # thousands alone
    return None if GROUPS_OF_THREE.fullmatch(text) else marks[0]


def _are_units(cells: list[str]) -> bool:
    filled = [c.strip("[](){} ") for c in cells if c.strip() not in ("", "-", "--", "[]", "[-]")]
    return bool(filled) and all(unit_named(c) is not None for c in filled)


def _median(counts: list[int]) -> int:
    return int(np.median(counts)) if counts else 0
