"""A lab's own table where a verb takes a recording: shown as understood, confirmed, stored next to it."""

import shlex
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources import plain
from pneutac_datasets.recording.sources.columns import LEAVE_OUT, Column
from pneutac_sim.errors import InputError, printable


def recording_folder(
    path: Path, yes: bool = False, mapping: Path | None = None, length_mm: float | None = None
) -> Path:
    """The folder of the recording that a path names: itself, or that of tables, which are converted.

    What was converted before is taken where neither the tables nor their mapping changed; where they did,
    they are converted again as the mapping says. Raises InputError where the tables cannot be understood, or
    nobody confirmed it, unless `yes`.
    """
    files = plain.table_files(path)
    if not files:
        return path
    folder = plain.folder_of(files)
    if plain.is_current(folder, files, mapping):
        return folder
    if folder.exists() and not plain.is_ours(folder):
        raise InputError(f"{folder} exists and is no earlier conversion; move it away.")
    known = mapping or (folder / plain.MAPPING if plain.is_ours(folder) else None)
    given = plain.Given.load(known) if known else plain.Given()
    understood = plain.Understood(files, replace(given, length_mm=length_mm or given.length_mm))
    if understood.faults:
        raise InputError(understood.faults[0])
    console = Console()
    if known is None or yes:
        show_understood(understood, console)
    columns, confirmed = {c.name: str(c) for c in understood.columns}, yes or known is not None
    for file in () if confirmed else folder.parent.glob(f"*{plain.ENDING}/{plain.MAPPING}"):
        with suppress(InputError):  # one that was edited and no longer reads
            confirmed = confirmed or plain.Given.load(file).columns == columns  # of a table next to this one
    if not confirmed:
        confirm(path)
    understood.write(folder, replaces=mapping is None)
    how = f", by {known}" if known else ""
    console.print(f"Stored in {folder}{how}.", highlight=False, soft_wrap=True, markup=False)
    return folder


def confirm(path: Path) -> None:
    """Asks whether the table that was shown is right; InputError where it is not, or nobody is there."""
    change = f"`pneutac convert {shlex.quote(str(path))} --columns='NAME: COLUMN [UNIT]'` changes it"
    if not sys.stdin.isatty():
        raise InputError(f"Add --yes if this is right; {change}.")
    answer = input("Is this right? [Y/n] ").strip().lower()
    if answer not in ("", "y", "yes", "j", "ja"):
        raise InputError(f"Nothing was converted; {change}.")


def show_understood(understood: plain.Understood, console: Console) -> None:
    """Prints what each column was taken for, and with which numbers."""
    first, last = understood.files[0], understood.files[-1]
    name = str(first) if len(understood.files) == 1 else f"{first} to {last.name}"
    line = f"{name}: {plain.extent(understood.recording)} ({understood.style})"
    console.print(line, highlight=False, soft_wrap=True, markup=False)
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for cells in _rows(understood):
        table.add_row(*(Text(printable(c)) for c in cells))
    console.print(table)
    if understood.length_mm is not None:
        rests = ", where the tip rests (`pneutac convert --length_mm=`)"
        where = "" if understood.given.length_mm else rests
        console.print(f"  length {understood.length_mm:g} mm{where}", highlight=False)
    for note in filter(None, (understood.guessed, *understood.notes)):
        console.print(f"[yellow]note:[/] {escape(printable(note))}", highlight=False, soft_wrap=True)


def _rows(understood: plain.Understood) -> list[tuple[str, str, str]]:
    """Source, column and range; the axes of one vector in one row."""
    rows: list[list] = []
    for c in understood.columns:
        if c.column == LEAVE_OUT:
            rows.append([[c.name], "left out", ""])
            continue
        stem = c.column.replace("_x_", "_xyz_").replace("_y_", "_xyz_").replace("_z_", "_xyz_")
        stem = stem[:-1] + "xyz" if c.column.startswith("gravity_") else stem
        how = _how(c)
        if rows and rows[-1][1] == stem and "xyz" in stem and rows[-1][2][0] == how:
            rows[-1][0].append(c.name)
            continue
        rows.append([[c.name], stem, [how, "" if "xyz" in stem else _range(c, understood.recording)]])
    have = understood.recording.samples
    for row in rows:  # the axes that there are
        axes = "".join(a for a in "xyz" if row[1].replace("xyz", a) in have)
        row[1] = row[1].replace("xyz", axes) if axes else row[1]
    return [(" ".join(names), stem, ": ".join(p for p in how if p)) for names, stem, how in rows]


def _how(c: Column) -> str:
    if c.retained:
        return "as it is"
    unit, by_size = "", c.guess == "by size"
    if c.unit is not None and (c.unit.factor, c.unit.shift) != (1.0, 0.0):
        unit = f"from {c.unit.name}"
    elif by_size and c.column not in ("time_s", "temperature_c"):
        unit = c.unit.name
    factor, shift = f"* {c.factor:g}" * (c.factor != 1), f"{c.shift:+g}" * bool(c.shift)
    return " ".join(filter(None, (unit, "by size" * (by_size and bool(unit)), factor, shift)))


def _range(c: Column, recording: Recording) -> str:
    values = recording.samples.get(c.column)
    if c.retained or values is None or values.dtype.kind not in "fiu" or c.column in ("trial", "time_s"):
        return ""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g} to {high:.3g}" if high > low else f"{low:.3g}"
