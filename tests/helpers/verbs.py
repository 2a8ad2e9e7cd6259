"""A verb with its options as keywords."""

import pytest

from lerobot_pneutac.cli import run_verb
from pneutac_sim.errors import InputError


def verb(name: str, *more: str, **options) -> None:
    """Runs a verb with names, then with `--option=value` for each keyword, then with options as they are."""
    names = [m for m in more if not m.startswith("--")]
    given = [f"--{option}={value}" for option, value in options.items()]
    run_verb(name, [*names, *given, *(m for m in more if m.startswith("--"))])


def refused(sentence: str, name: str, *more: str, **options) -> None:
    """Checks that a verb with such options ends in a sentence that matches."""
    with pytest.raises(InputError, match=sentence):
        verb(name, *more, **options)
