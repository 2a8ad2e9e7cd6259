"""A clock that stands still while this computer holds the process up: bounds of time then hold anywhere."""

import ctypes
import threading
import time

TICK_S = 0.005
MOST_S = 2 * TICK_S  # of a tick that count: in the rest of a longer one the process was held up
HELD_S = 0.03  # held up for so long an attempt says nothing

hold_up_us = ctypes.PyDLL(None).usleep  # keeps the interpreter: no thread runs for so many microseconds


class Awake:
    """Seconds since it was made in which this process was let run."""

    def __init__(self):
        self._seconds, self._ticked_s = 0.0, time.monotonic()
        threading.Thread(target=self._tick, name="awake", daemon=True).start()

    def __call__(self) -> float:
        return self._seconds + min(time.monotonic() - self._ticked_s, MOST_S)

    def _tick(self) -> None:
        while True:
            time.sleep(TICK_S)
            now_s = time.monotonic()
            self._seconds += min(now_s - self._ticked_s, MOST_S)
            self._ticked_s = now_s


awake_s = Awake()


def held_up_s() -> float:
    """For how long in all this process was held up; differences of it matter."""
    return time.monotonic() - awake_s()


def until(true, seconds=2.0):
    """Whether it came true in so many seconds of this process."""
    end_s = awake_s() + seconds
    while not true():
        if awake_s() > end_s:
            return False
        time.sleep(0.005)
    return True


def undisturbed(attempt, tries=8, own_s=0.0):
    """What an attempt returns; it is made again where it fails while the process was held up.

    Args:
        attempt: called without arguments.
        tries: at most.
        own_s: for which the attempt itself holds the process up.
    """
    for _ in range(tries - 1):
        before_s = held_up_s()
        try:
            return attempt()
        except Exception:
            if held_up_s() - before_s < own_s + HELD_S:
                raise
    return attempt()
