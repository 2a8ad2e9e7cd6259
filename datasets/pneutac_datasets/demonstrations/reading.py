"""Demonstrations as measurements: the episodes of a LeRobotDataset, checked before any work.

And what is known of a folder without reading them: whether it holds demonstrations, and of which task.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pneutac_sim.dataset_files import ACTION, ROBOT, STATE
from pneutac_sim.errors import InputError, from_hub, shown
from pneutac_sim.features import (
    AREA,
    CHAMBERS,
    CONTROL_HZ,
    EE,
    PRESSURE,
    chamber_count,
    library_tasks,
    task_names,
)
from pneutac_sim.pace import read_info
from pneutac_sim.twin import Twin

if TYPE_CHECKING:
    from pneutac_datasets.demonstrations.episodes import Episode
    from pneutac_datasets.demonstrations.faults import Recorded
    from pneutac_sim.world.station import Station

BEGIN, SOON = 5, 10  # frames in which nothing is touched yet, and before which no touch is one


def _paper() -> Station:
    from pneutac_sim.world.station import Station  # MuJoCo, for which bench recordings need not wait

    return Station()


@dataclass
class Demonstrations:
    """Episodes of one task."""

    folder: Path  # of the dataset, or its name on the Hub
    task: str  # in front of the robot, such as `switch`
    episodes: list[Episode]  # as recorded, at the rate of 15 Hz at which they are replayed
    device: str = "finger"  # of what they are measurements
    warnings: list[str] = field(default_factory=list)  # what a reader should know
    station: Station = field(default_factory=_paper)  # in which they were recorded, at the rate of 15 Hz

    pressure_columns = ("pressure_cmd_kpa",)

    def __len__(self) -> int:
        return sum(map(len, self.episodes))

    @cached_property
    def samples(self) -> pd.DataFrame:
        """Trial, time and pressures as a bench recording has them, a row a frame."""
        parts = [
            pd.DataFrame(
                {
                    "trial": i,
                    "time_s": np.arange(len(e)) / e.fps,
                    "pressure_cmd_kpa": e.action[:, 3],
                    "pressure_kpa": e.state[:, PRESSURE],
                }
            )
            for i, e in enumerate(self.episodes)
        ]
        return pd.concat(parts, ignore_index=True)

    def column(self, name: str) -> np.ndarray:
        """(n,) one column of `samples`."""
        return self.samples[name].to_numpy()

    def trials(self) -> dict[str, slice]:
        ends = np.cumsum([0, *map(len, self.episodes)])
        return {str(i): slice(a, b) for i, (a, b) in enumerate(zip(ends[:-1], ends[1:], strict=True))}


def is_dataset(name: str | Path) -> bool:
    """Whether this is a folder of demonstrations, or what may be one's name on the Hub (`user/name`)."""
    path = Path(name)
    on_hub = len(path.parts) == 2 and not path.is_absolute() and not path.parent.exists()
    return is_demonstrations(path) or on_hub


def load_demonstrations(
    name: str | Path,
    task: str = "",
    twin: Twin | None = None,
    only: Sequence[int] | None = None,
    station: Path | None = None,
) -> Demonstrations:
    """Reads a dataset of episodes of any rate, of a folder or of a name on the Hub.

    If omitted, the task is that of the dataset's instruction, the twin the built-in one, the episodes are
    all, and the station that in the dataset's `meta`, or the paper's. Raises InputError where it is no
    dataset of this robot, has no such episode, or they cannot serve as measurements.
    """
    from lerobot.datasets import LeRobotDataset

    from pneutac_datasets.demonstrations.episodes import load_episode, readable
    from pneutac_datasets.demonstrations.faults import Recorded
    from pneutac_sim.world.station import Station, station_of

    folder = Path(name)
    if not is_demonstrations(folder):
        with from_hub(f"There is no folder '{name}', and no dataset of that name came from the Hub"):
            folder = Path(LeRobotDataset(str(name), video_backend="pyav").root)
    where = replace(station_of(folder, station) or Station(), control_hz=CONTROL_HZ)
    recorded = Recorded(folder)
    _refuse(recorded, twin or Twin.builtin(), where)
    notes = recorded.notes(where)
    with readable(folder):
        dataset = LeRobotDataset(f"local/{folder.name}", folder, video_backend="pyav")
    count = len(recorded.episodes)
    if missing := [i for i in only or () if not 0 <= i < count]:
        raise InputError(f"{name} has no episode {missing[0]}; it has {count}, the first is 0.")
    numbers = range(count) if only is None else only
    with readable(folder):
        episodes = [load_episode(dataset, i).resampled(CONTROL_HZ) for i in numbers]
    for e in episodes:
        e.state[:, EE] += where.base_m  # demonstrations have positions in the arm's frame
    task = task or task_of(episodes[0].task, folder)
    return checked(Demonstrations(Path(name), task, episodes, warnings=notes, station=where))


def checked(given: Demonstrations) -> Demonstrations:
    """The same, where each episode has touch and a pressure that was measured.

    Raises InputError: one has not, or there is no such task.
    """
    from pneutac_datasets.demonstrations.faults import UNTOUCHED, unmeasurable
    from pneutac_sim.world.tasks import make_task

    make_task(given.task)
    given = _touch_anew(given)
    untouched = [i for i, e in enumerate(given.episodes) if e.contact() is None]
    if untouched:
        raise InputError(
            f"{given.folder}: episode {untouched[0]} {UNTOUCHED}, so it contains no information on the "
            "finger; leave it out with lerobot-edit-dataset."
        )
    for i, e in enumerate(given.episodes):
        if reason := unmeasurable(e.state, e.action, CONTROL_HZ):
            raise InputError(f"{given.folder}: in episode {i} {reason}")
    return given


def _touch_anew(given: Demonstrations) -> Demonstrations:
    """The same, where an episode begins in touch its area counted from its images against its first frames.

    So it begins where the light has drifted: every pixel differs from the rest image that the robot has.
    """
    from pneutac_datasets.demonstrations.imprint import areas

    begun = [i for i, e in enumerate(given.episodes) if (e.contact() or (len(e),))[0] < SOON]
    if not begun:
        return given
    episodes = list(given.episodes)
    for i in begun:
        e = episodes[i]
        state = e.state.copy()
        state[:, AREA] = areas(e.images, e.images[:BEGIN].mean(0).round().astype(np.uint8))
        episodes[i] = replace(e, state=state)
    note = (
        f"{given.folder}: {len(begun)} of {len(episodes)} episodes begin with contact_area.pos above 0, "
        "as where the gel's light has drifted; their contact is counted again against their own first frames."
    )
    return replace(given, episodes=episodes, warnings=[*given.warnings, note])


def _refuse(recorded: Recorded, twin: Twin, station: Station) -> None:
    robot = recorded.info.get("robot_type")
    if robot != ROBOT:
        what = f"robot_type is {shown(robot)}; give demonstrations of a '{ROBOT}' robot"
        raise InputError(f"{recorded.file}: {what}.")
    names = recorded.info["features"].get(ACTION, {}).get("names")
    if max(chamber_count(names if isinstance(names, list) else []), CHAMBERS.get(twin.device, 1)) > 1:
        raise InputError(
            f"{recorded.folder}: demonstrations are measurements of fingers of one chamber alone, and this"
            " body has several; compare it by a bench recording (--recording=)."
        )
    if faults := recorded.faults(twin, station, measured=True):
        raise InputError(faults[0])


def is_demonstrations(folder: str | Path) -> bool:
    """Whether a folder is a LeRobotDataset of a robot rather than a bench recording.

    One of another robot than this one that names a commanded pressure in kPa was measured on a bench.
    """
    file = Path(folder) / "meta" / "info.json"
    if not file.is_file():
        return False
    info = read_info(file)
    features = info["features"]
    if not {STATE, ACTION} & set(features):
        return False
    entries = {str(n) for f in features.values() for n in _names(f)} | set(features)
    measured = any(re.fullmatch(r"pressure_cmd_(\d+_)?kpa", n) for n in entries)
    return not (measured and info.get("robot_type") != ROBOT)


def _names(feature: dict) -> list:
    names = feature.get("names") or []
    names = next(iter(names.values()), []) if isinstance(names, dict) else names
    return names if isinstance(names, list) else []


def work_folder(out_root: Path) -> Path:
    """Where pieces of a new dataset lie until it is whole."""
    return out_root.with_name(out_root.name + ".work")


def check_new(out_root: Path, repo_id: str) -> None:
    """Raises InputError where a new dataset's folder exists, and no run is left to be tidied up there."""
    if out_root.exists() and not work_folder(out_root).exists():
        raise InputError(f"'{out_root}' exists; give a new folder for dataset '{repo_id}'.")


def task_to_do(given: str, instructions: list[str], folder: Path) -> str:
    """The task that demonstrations are of: the given one, or the one that their instructions name.

    Raises InputError: the instructions name none, several, or another one of the library's than was given.
    """
    from pneutac_sim.world.tasks import tasks_named

    if not given:
        tasks = {text: task_of(text, folder) for text in instructions}
        if len(set(tasks.values())) > 1:
            several = " and ".join(f"'{task}' ('{text}')" for text, task in tasks.items())
            raise InputError(f"{folder} holds demonstrations of {several}; give a dataset of one task.")
        return next(iter(tasks.values()))
    for text, named in ((text, tasks_named(text)) for text in instructions):
        if len(named) == 1 and named[0] != given and {given, *named} <= library_tasks():
            raise InputError(
                f"{folder}: the instruction '{text}' names the task '{named[0]}', not --task={given};"
                f" give demonstrations of '{given}', or --task={named[0]}."
            )
    return given


def task_of(instruction: str, folder: Path) -> str:
    """The task whose own instruction this is, or the only one that it names.

    Raises InputError: it is none's.
    """
    from pneutac_sim.world.tasks import tasks_named

    if len(named := tasks_named(instruction)) == 1:
        return named[0]
    raise InputError(
        f"{folder}: the instruction '{instruction}' names no task; say with task= which of "
        f"{', '.join(task_names())} stood in front of the robot."
    )
