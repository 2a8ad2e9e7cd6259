"""What one attack came to: a row of the table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """A row of the table.

    Attributes:
        attack: what was done.
        tried: how often.
        broken: one line for each time that it did harm.
        measured: what was measured beside, in words.
    """

    attack: str
    tried: int
    broken: tuple[str, ...]
    measured: str = ""
