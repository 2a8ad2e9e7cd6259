"""The one error type for bad input: its message is a full sentence naming the file, field and remedy.

Where a parameter is wrong the sentence begins with its name: the command line makes `--name` of it.
"""

from collections.abc import Iterable

MOST_SHOWN = 80  # characters of a value in a sentence


class InputError(ValueError):
    """Bad input from a user or a file. The command line prints its message alone, without a traceback."""


def shown(value) -> str:
    """A value as a sentence quotes it: its beginning, where it is long."""
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."


def check_choice(name: str, value: str, choices: Iterable[str]) -> None:
    """Raises InputError where a parameter's value is none of the choices."""
    if value not in choices:
        raise InputError(f"{name} is '{value}'; it must be one of {', '.join(choices)}.")


def check_least(least: float, **values: float) -> None:
    """Raises InputError where one of these parameters is below `least`, or is no number."""
    for name, value in values.items():
        if not value >= least:
            raise InputError(f"{name} is {value}; it must be {least} or more.")
