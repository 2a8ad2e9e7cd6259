"""Play, scrub and speed: a moment of something that has been recorded."""

import math
import threading
import time
from collections.abc import Callable

import viser

FRAMES_A_S = 20
SPEEDS = {"1 x": 1.0, "0.2 x": 0.2, "5 x": 5.0, "20 x": 20.0}


class Player:
    """A moment that moves on by itself, or by hand.

    Args:
        gui: of the viewer.
        show: called when the moment is another.
    """

    def __init__(self, gui: viser.GuiApi, show: Callable[[], None]):
        self._time = gui.add_slider("time, s", 0.0, 1.0, 0.01, 0.0)
        self._playing = gui.add_checkbox("Play", False)
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS))
        self._show, self._ready = show, False
        self._time.on_update(lambda _: show())
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="player")
        self._thread.start()

    @property
    def now_s(self) -> float:
        return self._time.value

    @now_s.setter
    def now_s(self, value: float) -> None:
        value, before = float(min(max(value, 0.0), self._time.max)), self._time.value
        self._time.value = value  # which shows it, where it is another
        if value == before:
            self._show()

    def reaches(self, end_s: float) -> None:
        """There is something to show, from 0 on."""
        end_s = math.floor(100 * end_s) / 100  # as the slider steps
        self._time.max, self._ready = end_s, True
        self._time.value = min(self._time.value, end_s)

    def _run(self) -> None:
        last = time.monotonic()
        while not self._stop.wait(1 / FRAMES_A_S):
            now = time.monotonic()
            dt, last = now - last, now
            if self._playing.value and self._ready:
                t = self._time.value + dt * SPEEDS[self._speed.value]
                self.now_s = t if t <= self._time.max else 0.0

    def close(self) -> None:
        self._stop.set()
        self._thread.join(timeout=2.0)
