"""How far a verb has come: a bar on a terminal, elsewhere a line at once and every ten seconds on stderr."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

LINE_S = 10.0


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Gives `progress(text, done, total)`; the total may grow."""
    if not console.is_terminal:
        yield _lines(Console(stderr=True) if console.file is sys.stdout else console)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(
        *columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True
    ) as bar:
        task = bar.add_task("starting", total=1)

        def progress(text: str, done: int, total: int) -> None:
            bar.update(task, description=text[:48], completed=done, total=max(total, 1))

        yield progress


def _lines(console: Console) -> Callable[[str, int, int], None]:
    last = -LINE_S

    def progress(text: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last >= LINE_S:
            last = time.monotonic()
            console.print(f"{text}: {done} of {total}" if total > 1 else f"{text} ...", highlight=False)

    return progress
