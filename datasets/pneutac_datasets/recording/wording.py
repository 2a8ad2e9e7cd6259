"""How numbers of things and rows of a table are named in sentences."""

from pathlib import Path


def plural(n: int, noun: str) -> str:
    """`1 row`, `2 rows`."""
    return f"{n} {noun}" + ("" if n == 1 else "s")


def an(device: str) -> str:
    """`a finger`, `an arm`."""
    return f"{'an' if device == 'arm' else 'a'} {device}"


def row_name(row: int, file: Path) -> str:
    """`row 3 (line 4 of the file)`: rows of data count from 1, and a text file has its header above them."""
    return f"row {row + 1}" + (f" (line {row + 2} of the file)" if file.suffix.lower() == ".csv" else "")
