"""How far a verb has come, on a terminal and elsewhere."""

import io

from rich.console import Console

from lerobot_pneutac.cli import terminal as module
from lerobot_pneutac.cli.terminal import progress_bar


def test_without_a_terminal_there_is_a_line_at_once_and_every_ten_seconds(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    console = Console(file=io.StringIO(), width=80)
    with progress_bar(console) as progress:
        for i in range(25):
            now[0] = float(i)
            progress("fitting", i, 25)
    assert console.file.getvalue().splitlines() == [f"fitting: {i} of 25" for i in (0, 10, 20)]


def test_a_terminal_gets_a_bar_that_leaves_nothing_behind():
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    with progress_bar(console) as progress:
        progress("fitting", 1, 2)
    assert "fitting" not in console.file.getvalue().split("\r")[-1]
