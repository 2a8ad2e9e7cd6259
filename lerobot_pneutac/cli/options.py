"""Command line options as dataclasses: a bad one ends in one sentence, as all bad input does."""

import typing

import draccus

from pneutac_sim.errors import InputError


def parse_options(config_class: type, argv: list[str]):
    """Reads `--name=value` options into a dataclass that validates itself; `a,b` is the list `[a,b]`.

    Raises:
        InputError: an option is malformed, or the dataclass refuses the values.
    """
    try:
        return draccus.parse(config_class, args=_with_lists(config_class, argv))
    except draccus.ParsingError as e:  # draccus hides what the dataclass itself raised
        cause = e
        while cause.__cause__ is not None and not isinstance(cause, InputError):
            cause = cause.__cause__
        raise cause if isinstance(cause, InputError) else InputError(" ".join(str(e).split())) from e


def _with_lists(config_class: type, argv: list[str]) -> list[str]:
    """The same arguments, those for tuples in brackets: draccus would take a text letter by letter."""
    hints = typing.get_type_hints(config_class)
    lists = {n for n, t in hints.items() if tuple in (typing.get_origin(a) for a in (t, *typing.get_args(t)))}
    out = []
    for argument in argv:
        name, given, value = argument.partition("=")
        bare = given and name.removeprefix("--") in lists and value and value[0] not in "[{"
        out.append(f"{name}=[{value}]" if bare else argument)
    return out
