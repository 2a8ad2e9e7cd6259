"""Counts the steps of a work that grows while it goes on."""

from collections.abc import Callable


class Steps:
    """Calls `progress(text, done, total)` as work is done."""

    def __init__(self, progress: Callable[[str, int, int], None] | None = None):
        self._progress = progress
        self._text, self._done, self._total = "", 0, 0

    def expect(self, text: str, count: int) -> None:
        """So many more steps, of this kind."""
        self._text, self._total = text, self._total + count
        self._report()

    def done(self) -> None:
        self._done += 1
        self._report()

    def _report(self) -> None:
        if self._progress is not None:
            self._progress(self._text, self._done, self._total)
