"""The one error type for bad input: its message is a full sentence naming the file, field and remedy.

Where a parameter is wrong the sentence begins with its name: the command line makes `--name` of it.
"""

import difflib
import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, fields
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np

# All but tab and newline: what a terminal obeys, and marks that turn the direction of text.
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
MOST_SHOWN = 80  # characters of a value in a sentence
MOST_LISTED = 10  # names in a sentence


class InputError(ValueError):
    """Bad input from a user or a file. The command line prints its message alone, without a traceback.

    Control characters of the message, which may quote a file, are written out: a terminal would obey them.
    """

    def __init__(self, message: str):
        super().__init__(printable(message))


def load_entry_point(point: EntryPoint) -> Any:
    """What a package offers; raises InputError where it does not load, whatever its module raises."""
    try:
        return point.load()
    except (Exception, SystemExit) as e:
        where = f"Entry point '{point.name}' of {point.group} ({point.value})"
        why = str(e).rstrip(".") or type(e).__name__
        raise InputError(f"{where} does not load: {why}; correct its package, or uninstall it.") from e


@contextmanager
def from_hub(sentence: str) -> Iterator[None]:
    """Makes any fault of the Hub or of the network one sentence, which begins with this one.

    Raises InputError: something failed inside.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as e:  # client, network and file cache have errors of their own, without a common class
        reason = (str(e).splitlines() or [""])[0].strip().rstrip(".") or type(e).__name__
        raise InputError(f"{sentence} ({reason}); check the name, your login and the network.") from e


def printable(text: str) -> str:
    r"""The text with its control characters written out, as `\x1b`."""
    return CONTROL.sub(lambda found: repr(found[0])[1:-1], text)


def shown(value) -> str:
    """A value as a sentence quotes it: its beginning, where it is long."""
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."


def unknown_names(given: Iterable, known: Iterable[str], kind: str = "field") -> list[str]:
    """`unknown field 'widht'; did you mean 'width'?` for each name that is none of these.

    A name that is given already is suggested only where no other is close.
    """
    given, known, out = [str(g) for g in given], list(known), []
    exist = ", ".join(known[:MOST_LISTED]) or "none"
    exist += f" and {len(known) - MOST_LISTED} more" * (len(known) > MOST_LISTED)
    for name in (g for g in given if g not in known):
        free = [k for k in known if k not in given]
        near = difflib.get_close_matches(name, free, n=1) or difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"those that exist are {exist}."
        out.append(f"unknown {kind} {shown(name)}; {hint}")
    return out


def option(name: str, value) -> str:
    """An option of a command to copy, `--twin='my twin'`: quoted for a shell where that needs it."""
    return f"--{name}={shlex.quote(str(value))}"


def check_choice(name: str, value: str, choices: Iterable[str]) -> None:
    """Raises InputError where a parameter's value is none of the choices."""
    if value not in choices:
        raise InputError(f"{name} is '{value}'; it must be one of {', '.join(choices)}.")


def check_least(least: float, **values: float) -> None:
    """Raises InputError where one of these parameters is below `least`, or is no number."""
    for name, value in values.items():
        if not value >= least:
            raise InputError(f"{name} is {value}; it must be {least} or more.")


def check_between(low: float, high: float, unit: str = "", **values) -> None:
    """Raises InputError where one of these parameters is no number from `low` to `high`."""
    for name, value in values.items():
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (number and low <= value <= high):
            given = f"{value:g}" if number else shown(value)
            raise InputError(f"{name} is {given}; give {low:g} to {high:g}{f' {unit}' if unit else ''}.")


def check_length(length_mm: float) -> None:
    """Raises InputError where it is no length of a finger, arm or gel in mm, as where it is in metres."""
    check_between(1, 1000, "mm", length_mm=length_mm)


def refuse_given(options, names: Iterable[str], why: str) -> None:
    """Raises InputError where one of these fields of a dataclass has another value than its default.

    That is what an option is refused by which would else be ignored; `why` follows its name.
    """
    for field in fields(options):
        made = field.default_factory
        default = field.default if made is MISSING else made()
        if field.name in names and getattr(options, field.name) != default:
            raise InputError(f"{field.name} {why}; leave it out.")


def as_number(value) -> float:
    """The value as a float; raises TypeError where it is no number, as true or a text."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise TypeError(f"{shown(value)} is no number")
    return float(value)


def as_numbers(value) -> list[float]:
    """The numbers of a list; raises TypeError where it is none, as a text or a mapping, or holds others."""
    if not isinstance(value, list | tuple | np.ndarray):
        raise TypeError(f"{shown(value)} is no list")
    return [as_number(x) for x in value]


def finite_array(what: str, value, shape: tuple[int, ...], dtype: type = np.float64) -> np.ndarray:
    """The value as a contiguous array of a shape, where -1 stands for any length.

    Raises InputError where it is not finite numbers of that shape; `what` begins the sentence.
    """
    try:
        array = np.ascontiguousarray(value, dtype)
    except (TypeError, ValueError):
        array = np.full(1, np.nan)
    fits = array.ndim == len(shape) and all(s in (-1, t) for s, t in zip(shape, array.shape, strict=True))
    if not fits or not np.isfinite(array).all():
        wanted = ", ".join("n" if s == -1 else str(s) for s in shape)
        raise InputError(f"{what} must be finite numbers of shape ({wanted}{',' * (len(shape) == 1)}).")
    return array
