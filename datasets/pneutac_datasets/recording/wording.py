"""How numbers of things and rows of a table are named in sentences.

What a look at a recording found, for people (a sentence) and for programs (where, and how much).
"""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError


class SourceFile(Path):
    """A file of text that a table was read from."""

    lines: np.ndarray | None = None  # line of the file (n,) in which each row stands


def plural(n: int, noun: str) -> str:
    """`1 row`, `2 rows`."""
    return f"{n} {noun}" + ("" if n == 1 else "s")


def an(device: str) -> str:
    """`a finger`, `an arm`."""
    return f"{'an' if device == 'arm' else 'a'} {device}"


def row_name(row: int, file: Path) -> str:
    """`row 3 (line 4 of the file)`: rows of data count from 1, and a text file has its header above them."""
    lines = getattr(file, "lines", None)
    if lines is not None and row < len(lines):
        return f"row {row + 1} (line {lines[row]} of the file)"
    return f"row {row + 1}" + (f" (line {row + 2} of the file)" if file.suffix.lower() == ".csv" else "")


def cut(text: str, most: int = 120) -> str:
    """A text, shortened where it is long."""
    return text if len(text) <= most else f"{text[: most - 4]} ..."


def listed(names) -> str:
    """`a, b, c`, of more than twelve names the first and how many more."""
    names = [cut(str(n), 40) for n in names]
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def joined(names) -> str:
    """`a, b and c`."""
    *most, last = map(str, names)
    return f"{', '.join(most)} and {last}" if most else last


@contextmanager
def collected(faults: list[str]) -> Iterator[None]:
    """While it lasts, a refusal becomes another of the faults."""
    try:
        yield
    except InputError as e:
        faults += [str(e)] * (str(e) not in faults)


# What may differ between two sentences on one cause: rows, episodes, files and numbers.
VARIES = re.compile(r"(?:row|episode|trial) \d+|[^\s'(]*/[^\s',:;)]*|(?<![\w.])[-+]?\d[\d.e+-]*\b")


def grouped(sentences: Iterable[str]) -> list[str]:
    """Each cause once: of sentences that differ in rows, files and numbers alone the first, with a count."""
    causes: dict[str, list[str]] = {}
    for sentence in dict.fromkeys(sentences):
        causes.setdefault(VARIES.sub("*", sentence), []).append(sentence)
    out = []
    for first, *others in causes.values():
        named = zip(*map(VARIES.findall, [first, *others]), strict=True)
        where = next((found[1:] for found in named if len(set(found)) > 1), ())
        where = [name.rpartition("/")[2] for name in where]
        more = f"{len(where)} more ({', '.join(where[:3])}{', ...' * (len(where) > 3)})"
        out.append(f"{first} The same holds for {more}." if where else first)
    return out


@dataclass(frozen=True, eq=False)
class Finding:
    """One fault or peculiarity of a recording."""

    kind: str  # what it is, one word
    sentence: str  # the same in words
    columns: tuple[str, ...] = ()  # concerned
    # row numbers (k,) concerned; empty where it is the whole column
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    numbers: dict[str, float] = field(default_factory=dict)  # how much, by name
