"""What one attack came to: a row of the table."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass

from pneutac_sim.errors import InputError

LONGEST_SENTENCE = 400


@dataclass(frozen=True)
class Outcome:
    """A row of the table.

    Attributes:
        attack: what was done.
        tried: how often.
        broken: one line for each time that it did harm.
        measured: what was measured beside, in words.
        refused: how often it ended in a sentence, of attacks that may.
    """

    attack: str
    tried: int
    broken: tuple[str, ...]
    measured: str = ""
    refused: int = 0


def judge(attack: str, number: int, attempt: Callable[[int], object]) -> Outcome:
    """Makes a number of attempts, each of which may succeed or end in one short sentence.

    Args:
        attack: what is done, for the table.
        number: of attempts.
        attempt: makes the attempt of a number; whatever it raises but an `InputError` is harm.
    """
    broken, refused, longest = [], 0, 0
    for i in range(number):
        try:
            attempt(i)
        except InputError as e:
            refused += 1
            longest = max(longest, len(str(e)))
            if len(str(e)) >= LONGEST_SENTENCE or "\n" in str(e):
                broken.append(f"{i}: no short sentence: {e}")
        except Exception as e:  # what a user would see as a traceback, of any kind
            where = traceback.extract_tb(e.__traceback__)[-1]
            broken.append(f"{i}: {type(e).__name__} at {where.filename}:{where.lineno}: {e}")
    measured = f"{refused} refused, the longest message {longest} characters"
    return Outcome(attack, number, tuple(broken), measured, refused)
