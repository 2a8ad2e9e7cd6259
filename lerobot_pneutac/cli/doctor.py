"""`pneutac doctor`: what is installed, what answers, and what to do where something does not."""

import sys

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_pneutac.verbs.doctor import FAIL, NOTE, OK, check_all

COLOURS = {OK: "green", NOTE: "yellow", FAIL: "red"}


def main(argv: list[str]) -> None:
    """Runs every check and prints one table; exits with 1 where something needed is missing."""
    if argv in (["-h"], ["--help"]):
        print("usage: pneutac doctor\n\nTells what is installed and what answers; takes no options.")
        return
    if argv:
        sys.exit("pneutac doctor takes no options.")
    rows = check_all()
    table = Table("", "state", "found", "remedy", box=None, header_style="dim")
    for name, state, found, remedy in rows:
        table.add_row(name, f"[{COLOURS[state]}]{state}[/]", escape(found), escape(remedy))
    Console().print(table)
    if any(state == FAIL for _, state, _, _ in rows):
        sys.exit(1)
