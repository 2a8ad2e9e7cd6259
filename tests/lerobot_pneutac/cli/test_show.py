"""What a hostile recording names reaches the terminal and the report as plain text."""

import io
from dataclasses import dataclass

import pytest
from rich.console import Console

from lerobot_pneutac.cli.terminal import show
from lerobot_pneutac.verbs.result import Result
from pneutac_sim.errors import InputError

HOSTILE = "a\x1b[2J[/nothing] <script>alert(1)</script> \x9b31m"


@dataclass(frozen=True)
class Hostile(Result):
    title = "Hostile"
    findings = (HOSTILE,)

    @property
    def sentence(self):
        return HOSTILE

    def rows(self):
        return [{"program": HOSTILE, "error": 1.0}]

    def remarks(self):
        return [f"[bold]where:[/] {HOSTILE}", "[bold]plain[/]"]

    def to_dict(self):
        return {"program": HOSTILE}


def test_names_are_text_on_a_terminal():
    out = io.StringIO()
    show(Hostile(), Console(file=out, width=200))
    text = out.getvalue()
    assert "\x1b" not in text and "\x9b" not in text
    assert text.count("\\x1b[2J[/nothing]") == 4 and text.count("<script>") == 4
    assert "[bold]plain" not in text


def test_names_are_text_in_a_report(tmp_path):
    page = Hostile().report(tmp_path, "pneutac compare '<script>'").read_text()
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page


@pytest.mark.parametrize("character", ["\x1b", "\x07", "\r", "\x9b", "\u202e"])
def test_no_message_moves_a_terminals_cursor(character):
    assert character not in str(InputError(f"field '{character}' is unknown."))
