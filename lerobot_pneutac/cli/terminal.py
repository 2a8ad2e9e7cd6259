"""The terminal of a command: sentences, results, and how far the work has come."""

import math
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import shorten

from rich import progress as bars
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.errors import MarkupError
from rich.markup import escape
from rich.progress import Progress
from rich.table import Column, Table
from rich.text import Text

from lerobot_pneutac.reports.page import cell
from pneutac_sim.errors import printable

BAR = 12  # characters of the bar
LINE_S = 10.0  # between two lines of progress where there is no bar


class Terminal:
    """What a command prints to."""

    def __init__(self, verb: str, argv: list[str]):
        self.console = Console()
        self.line = f"pneutac {verb} {shlex.join(argv)}"

    def say(self, text: str, markup: bool = False, **style) -> None:
        """Prints one line, which a reader may copy: not wrapped, nothing in it coloured."""
        self.console.print(text, highlight=False, soft_wrap=True, markup=markup, **style)

    def note(self, text: str) -> None:
        """Prints what a reader should look at."""
        self.say(f"[yellow]note:[/] {escape(printable(text))}", markup=True)

    def run[R](self, work: Callable[..., R], *given, **options) -> R:
        """What a function returns that is called with these and with `progress`, which is shown meanwhile."""
        with progress_bar(Console(stderr=True)) as progress:
            return work(*given, **options, progress=progress)

    def finish(self, result, out: Path | None, sentence: bool = True, store: Path | None = None):
        """Writes result and report into folder `out` (nothing where it is None), then prints the result.

        In this order, so that a reader of the output who goes away, such as `head`, costs no file. `store` is
        the folder of a twin whose next version the result is, stored once the report is there. Returns the
        result, which then knows its version.
        """
        paths = []

        def write(result) -> None:
            paths.extend([] if out is None else [result.report(out, self.line)])

        if store is None:
            write(result)
        else:
            result = result.save(store, write)
        self.show(result, sentence)
        for path in paths:
            self.say(f"report: {path}")
        self.next_step(result.next_step(out, self.line))
        return result

    def next_step(self, text: str) -> None:
        """Prints a command or a sentence on what to do next; nothing where it is empty."""
        if text:
            self.say(f"[bold]Do next:[/] {escape(printable(text))}", markup=True)

    def show(self, result, sentence: bool = True) -> None:
        show(result, self.console, sentence)


def show(result, console: Console, sentence: bool = True) -> None:
    for finding in result.findings_shown:
        console.print(f"[yellow]note:[/] {escape(printable(finding))}", highlight=False)
    if sentence and result.sentence:
        console.print(f"\n[bold]{escape(printable(result.sentence))}[/]\n", highlight=False)
    rows = result.rows()
    if rows:
        columns = (Column(str(k), overflow="fold") for k in rows[0])
        table = Table(*columns, title=result.title, title_justify="left", box=SIMPLE_HEAD)
        for row in rows:
            style = "yellow" if row.get("note", "held") not in ("", "held") else None
            table.add_row(*(Text(printable(cell(row[k], ""))) for k in rows[0]), style=style)
        console.print(table)
    for remark in result.remarks():
        # a command stays on one line, so that it can be copied
        console.print(unmarked(remark), highlight=False, soft_wrap="pneutac " in remark)


def unmarked(remark: str) -> Text:
    """A remark, whose markup is its style."""
    try:
        return Text.from_markup(printable(remark))
    except MarkupError:  # a name in it that looks like markup
        return Text(printable(remark))


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Gives `progress(text, done, total)`; the total may grow."""
    if not console.is_terminal:
        yield _lines(Console(stderr=True) if console.file is sys.stdout else console)
        return
    columns = "{task.description}", bars.BarColumn(BAR), bars.MofNCompleteColumn()
    times = bars.TimeElapsedColumn(), bars.TimeRemainingColumn()
    room = max(12, console.width - BAR - 36)  # beside bar, numbers and times
    with Progress(*columns, *times, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=1)

        def progress(text: str, done: int, total: int) -> None:
            bar.update(
                task, description=shorten(text, room, placeholder=" ..."), completed=done, total=max(total, 1)
            )

        yield progress


def _lines(console: Console) -> Callable[[str, int, int], None]:
    last, began = -LINE_S, {}  # of each text when the first of its work was done, and how much that was

    def progress(text: str, done: int, total: int) -> None:
        nonlocal last
        first, start_s = began.setdefault(text, (done, None))
        if start_s is None and done > first:  # what came before, such as compiling, comes once
            first, start_s = began[text] = done, time.monotonic()
        if time.monotonic() - last >= LINE_S:
            last = time.monotonic()
            line = f"{text}: {done} of {total}" if total > 1 else f"{text} ..."
            if total > 1 and start_s is not None and done > first:
                left_s = (last - start_s) * (total - done) / (done - first)
                line += f", about {math.ceil(left_s / 60)} min left"
            console.print(line, highlight=False)

    return progress
