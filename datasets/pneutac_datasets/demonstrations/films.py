"""The videos of a LeRobotDataset: which frames a file holds, and whether they can be decoded."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer

TOLERANCE_S = 1e-4  # LeRobot's, between the time of a row and that of its frame


@dataclass(frozen=True)
class Film:
    """What a video file holds."""

    times_s: np.ndarray  # (n,) times of the frames that are in the file to their last byte, ascending
    stated: int  # frames that its header promises

    @property
    def torn(self) -> bool:
        """Whether frames that the header promises are missing."""
        return len(self.times_s) < self.stated

    def lacks(self, wanted_s: np.ndarray) -> np.ndarray:
        """(k,) bool: at which of these times there is no frame within LeRobot's tolerance."""
        if not len(self.times_s):
            return np.ones(len(wanted_s), bool)
        after = np.searchsorted(self.times_s, wanted_s).clip(max=len(self.times_s) - 1)
        nearest = [np.abs(self.times_s[i] - wanted_s) for i in (after, np.maximum(after - 1, 0))]
        return np.minimum(*nearest) > TOLERANCE_S


def read_film(file: Path) -> Film:
    """Reads which frames a video holds, without decoding them.

    Raises:
        InputError: it is missing, a pointer of Git LFS, or no video.
    """
    import av  # which the bench, whose recordings have no videos, does without

    if not file.is_file():
        raise InputError(f"{file} is missing.")
    refuse_pointer(file)
    times: list[float] = []
    stated = 0
    try:
        with _opened(file) as container:
            stream = container.streams.video[0]
            stated = stream.frames
            for packet in container.demux(stream):
                if packet.size and packet.pts is not None and not packet.is_corrupt:
                    times.append(float(packet.pts * stream.time_base))
    except (av.FFmpegError, IndexError, OSError) as e:
        if not times:
            raise InputError(f"{file} cannot be opened as a video.") from e
    return Film(np.sort(times), stated)


def film_of(films: dict[Path, Film | InputError], file: Path) -> Film:
    """A video, opened once; raises InputError where it cannot be."""
    if file not in films:
        try:
            films[file] = read_film(file)
        except InputError as e:
            films[file] = e
    film = films[file]
    if isinstance(film, InputError):
        raise film
    return film


def frame_size(file: Path, times_s: Sequence[float]) -> tuple[int, int]:
    """Decodes the frames at these times; returns their height and width.

    Raises:
        InputError: one of them cannot be decoded.
    """
    import av

    try:
        with _opened(file) as container:
            stream = container.streams.video[0]
            for time_s in times_s:
                container.seek(round(time_s / stream.time_base), stream=stream)
                decoded = (f for f in container.decode(stream) if f.time is not None)
                frame = next(f for f in decoded if f.time > time_s - TOLERANCE_S)
    except (av.FFmpegError, StopIteration, OSError) as e:
        raise InputError(f"{file}: the frame at {time_s:.2f} s cannot be decoded.") from e
    return frame.height, frame.width


@contextlib.contextmanager
def _opened(file: Path) -> Iterator:
    """A video as PyAV's container, while libav's own messages about damage stay silent."""
    import av

    av.logging.set_libav_level(av.logging.PANIC)
    try:
        with av.open(str(file)) as container:
            yield container
    finally:
        av.logging.set_libav_level(av.logging.INFO)
