"""How fast an episode was recorded: its control loop may fall behind, and LeRobot's own times do not show it.

LeRobot 0.6 gives a robot no hook for episodes, stores frame / fps as a frame's time, and observes a robot in
the pause between episodes as within them. What it announces in the log, and how many frames it counts, tell
which observations are an episode's: the first ones after the last announcement.
"""

import json
import logging
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import override

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.files import whole

PACE_FILE = "achieved_rate.json"  # in a dataset's `meta`; LeRobot drops what it does not know from info.json
SHORT = 0.95  # of the rate that was asked for: less is told
LATE = 1.5  # periods after which a frame is late
BEGINS = "Recording episode"  # so lerobot-record and lerobot-rollout announce one

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Pace:
    """Of one episode.

    Attributes:
        achieved_hz: mean rate of its frames by the clock.
        late_frames: how many came more than half a period late.
        longest_s: the longest time between two.
    """

    achieved_hz: float
    late_frames: int
    longest_s: float

    @classmethod
    def of(cls, times_s: Sequence[float], fps: float) -> "Pace":
        """Of two or more frames that were taken at these times, at a rate of `fps`."""
        apart = np.diff(times_s)
        hz = round(1 / float(apart.mean()), 3)
        return cls(hz, int((apart > LATE / fps).sum()), round(float(apart.max()), 4))


def short_of(pace: Pace, fps: float) -> bool:
    """Whether an episode fell short of its rate."""
    return pace.achieved_hz < SHORT * fps


def read_pace(meta: Path) -> dict[int, Pace]:
    """Episode to pace, from a dataset's folder `meta`; empty where nothing was kept.

    Raises:
        InputError: the file is damaged.
    """
    file = meta / PACE_FILE
    try:
        content = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        return {int(k): Pace(**v) for k, v in content.items()}
    except (ValueError, TypeError, AttributeError) as e:
        raise InputError(f"{file} is damaged ({e}); delete it, the dataset does without.") from e


def pace_notes(meta: Path, fps: float) -> list[str]:
    """A sentence where episodes of a dataset fell short of their rate."""
    slow = {k: p for k, p in read_pace(meta).items() if short_of(p, fps)}
    if not slow:
        return []
    each = ", ".join(f"{k} ({p.achieved_hz:.1f} Hz, {p.late_frames} frames late)" for k, p in slow.items())
    return [
        f"The loop fell short of {fps:g} Hz in {'episode' if len(slow) == 1 else 'episodes'} {each}, so their"
        " motions are stored as faster than they were: free the computer (fewer or smaller cameras, video"
        " encoding afterwards) and record them anew."
    ]


class Keeper(logging.Handler):
    """Adds each episode's pace to the dataset that LeRobot records here, and writes its `info.json` whole."""

    def __init__(self):
        super().__init__(logging.INFO)
        self._times_s: list[float] | None = None

    def connect(self) -> None:
        """From now on episodes are noticed."""
        io_utils = sys.modules.get("lerobot.datasets.io_utils")
        if io_utils is not None:
            io_utils.write_json = self._write_json
            logging.getLogger().addHandler(self)

    def disconnect(self) -> None:
        """Nothing is noticed any more."""
        logging.getLogger().removeHandler(self)

    @override
    def emit(self, record: logging.LogRecord) -> None:
        if record.getMessage().startswith(BEGINS):
            self._times_s = []

    def observed(self) -> None:
        """The robot was observed now."""
        if self._times_s is not None:
            self._times_s.append(time.perf_counter())

    def _write_json(self, data: dict, fpath: Path) -> None:
        """In place of LeRobot's, which empties the old file and writes it anew after every episode.

        A kill meanwhile loses the features' names and the frame rate, which nothing else tells. `pneutac
        repair` finds all the rest.
        """
        fpath = Path(fpath)
        frames = data.get("total_frames", 0) - _frames(fpath) if fpath.name == "info.json" else 0
        with whole(fpath) as part:
            part.write_text(json.dumps(data, indent=4, ensure_ascii=False), encoding="utf-8")
        if frames > 1 and self._times_s is not None and len(self._times_s) >= frames:
            self._keep(fpath.parent, data["total_episodes"] - 1, data["fps"], self._times_s[:frames])
        if frames:
            self._times_s = None

    def _keep(self, meta: Path, episode: int, fps: float, times_s: list[float]) -> None:
        pace = Pace.of(times_s, fps)
        try:
            kept = {**read_pace(meta), episode: pace}
        except InputError as e:  # no reason to lose an episode
            logger.warning("%s", e)
            return
        content = {str(k): vars(p) for k, p in sorted(kept.items())}
        with whole(meta / PACE_FILE) as part:
            part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        if short_of(pace, fps):
            logger.warning(
                "Episode %d ran at %.1f Hz and not at %g: its motions are stored as faster than they were.",
                *(episode, pace.achieved_hz, fps),
            )


def _frames(info: Path) -> int:
    """Frames that an `info.json` counts; 0 where there is none yet."""
    return json.loads(info.read_text(encoding="utf-8")).get("total_frames", 0) if info.is_file() else 0
