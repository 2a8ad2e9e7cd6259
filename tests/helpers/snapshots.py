"""Sentences word for word: `tests/snapshots/NAME.txt` holds cases, and below each what is said of it.

`PNEUTAC_SNAPSHOTS=write pytest tests/test_sentences.py` writes those of all cases that it runs anew; read
what changed before a commit. A new command is a line in the file, with any text below it.
"""

import os
from pathlib import Path

import pytest

from pneutac_sim.errors import InputError

FOLDER = Path(__file__).parents[1] / "snapshots"


class Sentences:
    """The cases of a file and what is said of them."""

    def __init__(self, name: str):
        self._file = FOLDER / f"{name}.txt"
        parts = self._file.read_text().strip().split("\n\n")
        self.said = {case: said for case, _, said in (part.partition("\n") for part in parts)}

    @property
    def commands(self) -> list[str]:
        return [case.removeprefix("pneutac ") for case in self.said if case.startswith("pneutac ")]

    def check(self, case: str, call) -> str:
        """Calls what must be refused, in words that stand in the file, and returns them."""
        with pytest.raises((InputError, SystemExit)) as error:
            call()
        said = "\n".join(line for line in str(error.value).splitlines() if line.strip())
        assert "/tmp" not in said and "Traceback" not in said
        if os.environ.get("PNEUTAC_SNAPSHOTS") == "write":
            self.said[case] = said
            self._file.write_text("\n\n".join(f"{c}\n{s}" for c, s in self.said.items()) + "\n")
        assert self.said.get(case) == said
        return said
