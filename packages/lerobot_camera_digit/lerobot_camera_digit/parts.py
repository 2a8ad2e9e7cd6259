"""How hardware is waited for, and how it and its options say that something is wrong.

Importing ends in one sentence where LeRobot is too old, whose own imports would end in tracebacks.
"""

import re
import sys
import time
from collections.abc import Callable
from importlib.metadata import version

from draccus.utils import DecodingError

OLDEST = "0.6.1"

if [int(n) for n in re.findall(r"\d+", version("lerobot"))[:3]] < [int(n) for n in OLDEST.split(".")]:
    sys.exit(
        f"LeRobot {version('lerobot')} is too old for lerobot_camera_digit and lerobot_robot_pneutac; they"
        f" need {OLDEST} or later; pip install 'lerobot>={OLDEST},<0.7'."
    )

TICK_S = 0.02  # between two looks at what is waited for
TURNS = 3  # of a listening thread, after which a part that is alive has been heard


class HardwareFault(RuntimeError):  # noqa: N818
    """A part stopped working; the message is one sentence: which part, what happened, what to do."""


def refuse_if(wrong: bool, sentence: str) -> None:
    """Raises what LeRobot's commands print as one line; they hide the text of any other error."""
    if wrong:
        raise DecodingError((), sentence)


class Clock:
    """The computer's clock; tests put a simulated one into `parts.clock`."""

    now = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)


clock = Clock()


def wait(
    until: Callable[[], bool],
    limit_s: float,
    tick_s: float = TICK_S,
    pause: Callable[[float], object] | None = None,
) -> bool:
    """Waits until something is true; the one way in which hardware is waited for.

    A computer that was held up finds everything too old until the threads that listen have had their turn;
    that is no part's fault. So a pause counts twice its time at most, and there are `TURNS` pauses at least.

    Args:
        until: asked at once, and after every pause. What it raises ends the waiting.
        limit_s: pauses in sum, s; infinite where `until` itself ends the waiting.
        tick_s: a pause, s.
        pause: waits for up to so many seconds, such as a thread's `join`; by default the clock's `sleep`.
    """
    waited_s, pauses = 0.0, 0
    while not until():
        if pauses >= TURNS and waited_s >= limit_s - 1e-9:
            return False
        began_s = clock.now()
        (pause or clock.sleep)(tick_s)
        waited_s += min(clock.now() - began_s, 2 * tick_s)
        pauses += 1
    return True
