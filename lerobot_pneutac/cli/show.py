"""A verb's result on the terminal and in a folder."""

import shlex
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.errors import MarkupError
from rich.markup import escape
from rich.table import Column, Table
from rich.text import Text

from lerobot_pneutac.reports.page import cell
from pneutac_sim.errors import printable


def finish(
    result, console: Console, out: Path | None, verb: str, argv: list[str], sentence: bool = True
) -> None:
    """Writes result and report into folder `out` (nothing where it is None), then prints the result.

    In this order, so that a reader of the output who goes away, such as `head`, costs no file.
    """
    path = None if out is None else result.report(out, f"pneutac {verb} {shlex.join(argv)}")
    show(result, console, sentence)
    if path is not None:
        console.print(f"report: {path}", highlight=False, soft_wrap=True)


def show(result, console: Console, sentence: bool = True) -> None:
    """Prints notes, sentence, table and remarks of a `Result`."""
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
        console.print(_remark(printable(remark)), highlight=False)


def _remark(text: str) -> Text:
    """A remark may be marked up; a name in it that looks like markup is none."""
    try:
        return Text.from_markup(text)
    except MarkupError:
        return Text(text)
