"""Command line options as dataclasses: a bad one ends in one sentence, as all bad input does."""

import draccus

from pneutac_sim.errors import InputError


def parse_options(config_class: type, argv: list[str]):
    """Reads `--name=value` options into a dataclass that validates itself.

    Raises:
        InputError: an option is malformed, or the dataclass refuses the values.
    """
    try:
        return draccus.parse(config_class, args=argv)
    except draccus.ParsingError as e:  # draccus hides what the dataclass itself raised
        cause = e
        while cause.__cause__ is not None and not isinstance(cause, InputError):
            cause = cause.__cause__
        raise cause if isinstance(cause, InputError) else InputError(" ".join(str(e).split())) from e
