"""A dataset's `meta`: its `info.json`, how fast a robot's loop ran in each episode, and how each ended.

LeRobot's times do not show a loop that falls behind, and its recorder does not ask whether the task was done.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from pneutac_sim.errors import InputError, as_number, shown
from pneutac_sim.files import read_json

PACE_FILE = "achieved_rate.json"  # in a dataset's `meta`; LeRobot drops what it does not know from info.json
OUTCOME_FILE = "outcomes.json"  # likewise: episode to `DONE` or why it failed
DONE = "done"
PROVENANCE = "provenance.jsonl"  # likewise: how `augment` made each episode, a line each
SHORT, FAST = 0.98, 1.02  # of the rate that was asked for: less and more are reported
VERSION = 3  # of LeRobot's datasets
LATE = 1.5  # periods after which a frame is late


def info_file(folder: str | Path) -> Path:
    """`meta/info.json` of a dataset; raises InputError where there is none."""
    file = Path(folder) / "meta" / "info.json"
    if not file.is_file():
        raise InputError(f"'{folder}' holds no LeRobotDataset (no meta/info.json).")
    return file


def read_info(file: Path) -> dict:
    """The content of its `meta/info.json`; raises InputError where that is damaged."""
    info = read_json(file)
    info.setdefault("features", {})
    if not isinstance(info["features"], dict) or not all(
        isinstance(f, dict) for f in info["features"].values()
    ):
        raise InputError(f"{file}: 'features' must be an object of objects; the dataset is damaged.")
    return info


def refuse_version(file: Path, info: dict) -> None:
    """Raises InputError where an `info.json` is of another version of LeRobot's datasets than 3."""
    version = info.get("codebase_version")
    found = re.fullmatch(r"v?(\d+)\.\d+(\.\d+)?", str(version))
    if found and int(found[1]) == VERSION:
        return
    root = file.parent.parent
    if str(version) == "v2.1":
        remedy = (
            "convert it with `python -m lerobot.scripts.convert_dataset_v21_to_v30"
            f" --repo-id={quote(f'local/{root.name}')} --root={quote(str(root))} --push-to-hub=false`"
        )
    elif str(version) == "v2.0":
        remedy = (
            "convert it first to v2.1, on the Hub, with an older LeRobot: `uvx --from lerobot==0.3.3 python"
            " -m lerobot.datasets.v21.convert_dataset_v20_to_v21 --repo-id=NAME`, then to v3.0 with `python"
            " -m lerobot.scripts.convert_dataset_v21_to_v30 --repo-id=NAME`"
        )
    elif found and int(found[1]) < VERSION:
        remedy = "convert it with the LeRobot that recorded it, first to v2.1 and then to v3.0"
    elif found:
        remedy = "it was recorded with a newer LeRobot; install that one, or record again"
    else:
        remedy = "restore the file"
    raise InputError(f"{file}: codebase_version is {shown(version)}, and v3.0 is read here; {remedy}.")


@dataclass(frozen=True)
class Pace:
    """Of one episode."""

    achieved_hz: float  # mean rate of its frames by the clock
    late_frames: int  # how many came more than half a period late
    longest_s: float  # the longest time between two
    # whether the robot stood still between two frames and moved on by one period with each
    simulated: bool = False

    def __post_init__(self):
        for value in (self.achieved_hz, self.late_frames, self.longest_s):
            if not 0 <= as_number(value) < math.inf:
                raise ValueError(f"{value} is no rate, count or time")

    @classmethod
    def of(cls, times_s: Sequence[float], fps: float) -> "Pace":
        """Of two or more frames that were taken at these times, at a rate of `fps`."""
        intervals = np.diff(times_s)
        hz = round(1 / float(intervals.mean()), 3)
        return cls(hz, int((intervals > LATE / fps).sum()), round(float(intervals.max()), 4))


def short_of(pace: Pace, fps: float) -> bool:
    """Whether an episode fell short of its rate."""
    return pace.achieved_hz < SHORT * fps


def faster_than(pace: Pace, fps: float) -> bool:
    """Whether an episode has more frames a second than its rate."""
    return pace.achieved_hz > FAST * fps


def read_pace(meta: Path) -> dict[int, Pace]:
    """Episode to pace, from a dataset's folder `meta`; empty where nothing was stored.

    Raises InputError where the file is damaged.
    """
    return _of_episodes(meta / PACE_FILE, lambda v: Pace(**v), "delete it, the dataset does without.")


def read_outcomes(meta: Path) -> dict[int, str]:
    """Episode to `DONE` or the reason of its failure, from a dataset's folder `meta`; those that are known.

    Raises InputError where the file is damaged.
    """
    remedy = f'write {{"0": "{DONE}", "1": "why it failed"}}, or delete it.'
    return _of_episodes(meta / OUTCOME_FILE, str, remedy)


def _of_episodes[T](file: Path, value: Callable[[Any], T], remedy: str) -> dict[int, T]:
    try:
        content = read_json(file) if file.exists() else {}
        return {int(k): value(v) for k, v in content.items() if int(k) >= 0}
    except (ValueError, TypeError, AttributeError) as e:
        raise InputError(f"{file} is damaged ({e}); {remedy}") from e


def pace_notes(meta: Path, fps: float) -> list[str]:
    """A sentence where episodes of a dataset were slower than their rate, and one where they were faster."""
    paces, notes = read_pace(meta), []

    def which(chosen: dict[int, Pace]) -> str:
        each = (f"{k} ({p.achieved_hz:.1f} Hz, {p.late_frames} frames late)" for k, p in chosen.items())
        return f"{'episode' if len(chosen) == 1 else 'episodes'} {', '.join(each)}"

    if slow := {k: p for k, p in paces.items() if short_of(p, fps)}:
        notes.append(
            f"The loop fell short of {fps:g} Hz in {which(slow)}, so their motions are stored as faster than"
            " they were: free the computer (fewer or smaller cameras, video encoding afterwards) and record"
            " them again."
        )
    fast = {k: p for k, p in paces.items() if faster_than(p, fps)}
    if real := {k: p for k, p in fast.items() if not p.simulated}:
        notes.append(
            f"The loop ran faster than {fps:g} Hz in {which(real)}, so their motions are stored as slower"
            " than they were: record them again without --interpolation_multiplier, and with --fps and"
            f" --dataset.fps of {fps:g}."
        )
    if simulated := {k: p for k, p in fast.items() if p.simulated}:
        notes.append(
            f"The loop ran faster than {fps:g} Hz in {which(simulated)} of a simulated robot, which moves on"
            f" by 1/{fps:g} s a frame: the policy acted less often than at {fps:g} Hz. Record them again"
            " without --interpolation_multiplier."
        )
    return notes
