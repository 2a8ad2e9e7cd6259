"""A verb's result on the terminal and in a folder."""

import shlex
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_pneutac.reports.page import cell


def show(result, console: Console, sentence: bool = True) -> None:
    """Prints findings, sentence, table and remarks of a `Result`."""
    for finding in result.findings:
        console.print(f"[yellow]note:[/] {finding}", highlight=False)
    if sentence and result.sentence:
        console.print(f"\n[bold]{escape(result.sentence)}[/]\n", highlight=False)
    rows = result.rows()
    if rows:
        table = Table(*map(str, rows[0]), title=result.title)
        for row in rows:
            style = "yellow" if row.get("note", "held") not in ("", "held") else None
            table.add_row(*(cell(row[k], "") for k in rows[0]), style=style)
        console.print(table)
    for remark in result.remarks():
        console.print(remark, highlight=False)


def write(result, out: Path | None, verb: str, argv: list[str], console: Console) -> None:
    """Writes result and report into folder `out`, nothing where it is None."""
    if out is not None:
        path = result.report(out, f"pneutac {verb} {shlex.join(argv)}")
        console.print(f"report: {path}", highlight=False)
