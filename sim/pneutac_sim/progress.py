"""Progress of long work."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]  # a few words, what is done and of how much


def no_progress(text: str, done: int, total: int) -> None:
    """Reports nothing."""
