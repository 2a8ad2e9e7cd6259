"""Tables of the benchmarks: mean and standard error, as markdown and on a terminal; files written at once."""

from collections.abc import Iterable, Sequence

import numpy as np
from rich.table import Table


def mean_sem(values: Iterable[float | None]) -> list[float | None]:
    """Mean and its standard error; the latter is None for a single value, both for none."""
    v = np.asarray([x for x in values if x is not None], float)
    if not len(v):
        return [None, None]
    return [float(v.mean()), float(v.std(ddof=1) / np.sqrt(len(v))) if len(v) > 1 else None]


def shown(value: Sequence[float | None], digits: int = 2, sign: str = "") -> str:
    """`1.20 ± 0.05`, `1.20` of a single value, `-` of none."""
    mean, sem = value
    if mean is None:
        return "-"
    return f"{mean:{sign}.{digits}f}" + ("" if sem is None else f" ± {sem:.{digits}f}")


def markdown(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    """Lines of a table."""
    heads = list(heads)
    return [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *(f"| {' | '.join(r)} |" for r in rows)]


def terminal(title: str, heads: Iterable[str], rows: Iterable[Iterable[str]], left: int = 99) -> Table:
    """The same for a terminal; columns after the first `left` stand at the right."""
    table = Table(title=title)
    for i, head in enumerate(heads):
        table.add_column(head, justify="left" if i < left else "right")
    for row in rows:
        table.add_row(*row)
    return table
