"""Indenters of any form, as the rows of a gel's recording describe them."""

from functools import lru_cache
from pathlib import Path

import pandas as pd

from pneutac_datasets.recording.wording import shown
from pneutac_sim.errors import InputError
from pneutac_sim.files import inside
from pneutac_sim.gel.figure import AnyFigure, Figure, Outline


def figure_of(folder: Path, row: pd.Series, indenter: str) -> AnyFigure | None:
    """The figure of a row's indenter; None where it is one of the plain shapes.

    Args:
        folder: of the recording, in which `indenter_file` lies.
        row: with `outline_mm` for an `outline`, `indenter_file` for a `mesh`.
        indenter: of the row.

    Raises:
        InputError: the column is empty, or what it names is no indenter.
    """
    if indenter == "outline":
        return Outline.of_text(_text(row, "outline_mm", "give its corners in mm, x y; x y; x y"))
    if indenter == "mesh":
        name = _text(row, "indenter_file", "name the STL inside the recording's folder")
        file = folder / name
        if "\0" in name or not inside(folder, file):
            raise InputError(f"indenter_file {shown(name)} lies outside the recording's folder.")
        return _read(file, file.stat().st_mtime_ns if file.is_file() else 0)
    return None


def _text(row: pd.Series, column: str, remedy: str) -> str:
    value = row.get(column)
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{column} is empty; {remedy}.")
    return value


@lru_cache(maxsize=16)
def _read(file: Path, changed: int) -> Figure:
    return Figure.read(file)
