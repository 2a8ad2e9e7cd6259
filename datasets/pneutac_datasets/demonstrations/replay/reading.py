"""Demonstrations as measurements: the episodes of a LeRobotDataset, checked before any work."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pneutac_datasets.demonstrations.info import is_demonstrations
from pneutac_sim.errors import InputError
from pneutac_sim.features import (
    AREA,
    CHAMBERS,
    CONTROL_HZ,
    EE,
    PRESSURE,
    chamber_count,
    joint_count,
    task_names,
)
from pneutac_sim.twin import Twin

if TYPE_CHECKING:
    from pneutac_datasets.demonstrations.episodes import Episode
    from pneutac_sim.world.station import Station

ROBOT = "pneutac"
BEGIN, SOON = 5, 10  # frames in which nothing is touched yet, and before which no touch is one
JUMP_M = 0.03  # in a frame, four times the fastest
LEAST_KPA = 0.5  # travel of a command of pressure that a gauge must show


def _paper() -> Station:
    from pneutac_sim.world.station import Station  # MuJoCo, for which bench recordings need not wait

    return Station()


@dataclass
class Demonstrations:
    """Episodes of one task.

    Attributes:
        folder: of the dataset, or its name on the Hub.
        task: in front of the robot, such as `switch`.
        episodes: as recorded, at the rate of 15 Hz at which they are replayed.
        device: of what they are measurements.
        warnings: what a reader should know.
        station: in which they were recorded, at the rate of 15 Hz.
    """

    folder: Path
    task: str
    episodes: list[Episode]
    device: str = "finger"
    warnings: list[str] = field(default_factory=list)
    station: Station = field(default_factory=_paper)

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
        """Rows of each episode."""
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
    """Reads a dataset of episodes of any rate.

    Args:
        name: its folder, or its name on the Hub.
        task: in front of the robot; left out, the one that the dataset's instruction names.
        twin: whose sensor and range of pressures they have; left out, the built-in one.
        only: numbers of the episodes that are read; left out, all.
        station: file `station.yaml` of where they were recorded; left out, the one that the robot left in the
            dataset's `meta`, or the paper's.

    Raises:
        InputError: it is no dataset of this robot, has no such episode, or they cannot serve as measurements.
    """
    from huggingface_hub.errors import HfHubHTTPError
    from lerobot.datasets import LeRobotDataset

    from pneutac_datasets.demonstrations.episodes import load_episode
    from pneutac_sim.world.station import Station, station_file

    folder = Path(name)
    if not is_demonstrations(folder):
        try:
            folder = Path(LeRobotDataset(str(name), video_backend="pyav").root)
        except (OSError, ValueError, HfHubHTTPError) as e:
            raise InputError(
                f"There is no folder '{name}', and no dataset of that name on the Hub ({e})."
            ) from e
    file = station_file(folder, station)
    where = replace(Station.load(file) if file else Station(), control_hz=CONTROL_HZ)
    _refuse(folder, twin or Twin.builtin(), where, file)
    dataset = LeRobotDataset(f"local/{folder.name}", folder, video_backend="pyav", return_uint8=True)
    count = dataset.meta.total_episodes
    if missing := [i for i in only or () if not 0 <= i < count]:
        raise InputError(f"{name} has no episode {missing[0]}; it has {count}, the first is 0.")
    numbers = range(count) if only is None else only
    episodes = [load_episode(dataset, i).resampled(CONTROL_HZ) for i in numbers]
    for e in episodes:
        e.state[:, EE] += where.base_m  # demonstrations tell places in the arm's frame
    task = task or task_of(episodes[0].task, folder)
    return checked(Demonstrations(Path(name), task, episodes, station=where))


def checked(given: Demonstrations) -> Demonstrations:
    """The same, where each episode has touch and a pressure that was measured.

    Raises:
        InputError: one has not, or there is no such task.
    """
    from pneutac_sim.world.tasks import make_task

    make_task(given.task)
    given = _touch_anew(given)
    untouched = [i for i, e in enumerate(given.episodes) if e.contact() is None]
    if untouched:
        raise InputError(
            f"{given.folder}: episode {untouched[0]} never touches anything (contact_area.pos is 0 "
            "throughout), so it tells nothing of the finger; leave it out with lerobot-edit-dataset."
        )
    for i, e in enumerate(given.episodes):
        step_m = np.linalg.norm(np.diff(e.state[:, EE], axis=0), axis=1)
        if step_m.max() > JUMP_M:
            raise InputError(
                f"{given.folder}: in episode {i} the flange jumps by {1e3 * step_m.max():.0f} mm at "
                f"{step_m.argmax() / CONTROL_HZ:.1f} s, as where frames were lost or the scene was started "
                "afresh; leave it out with lerobot-edit-dataset."
            )
        if np.ptp(e.action[:, 3]) > LEAST_KPA and np.ptp(e.state[:, PRESSURE]) < 1e-6:
            raise InputError(
                f"{given.folder}: in episode {i} pressure.pos stays at {e.state[0, PRESSURE]:g} kPa while "
                "the command moves; log the gauge of the chamber, or leave the episode out."
            )
    return given


def _touch_anew(given: Demonstrations) -> Demonstrations:
    """The same, where an episode begins in touch its area counted from its images against its first frames.

    So it begins where the light has drifted: every pixel differs from the rest image that the robot has.
    """
    from pneutac_datasets.demonstrations.replay.imprint import areas

    begun = [i for i, e in enumerate(given.episodes) if (e.contact() or (len(e),))[0] < SOON]
    if not begun:
        return given
    episodes = list(given.episodes)
    for i in begun:
        e = episodes[i]
        state = e.state.copy()
        state[:, AREA] = areas(e.images, e.images[:BEGIN].mean(0).round().astype(np.uint8))
        episodes[i] = replace(e, state=state)
    told = (
        f"{given.folder}: {len(begun)} of {len(episodes)} episodes begin with contact_area.pos above 0, "
        "as where the gel's light has drifted; their contact is counted anew against their own first frames."
    )
    return replace(given, episodes=episodes, warnings=[*given.warnings, told])


def _refuse(folder: Path, twin: Twin, station: Station, file: Path | None) -> None:
    from pneutac_datasets.demonstrations.faults import demonstration_faults

    info = json.loads((folder / "meta" / "info.json").read_text(encoding="utf-8"))
    robot = info.get("robot_type")
    if robot != ROBOT:
        raise InputError(
            f"{folder / 'meta' / 'info.json'}: robot_type is '{robot}'; give demonstrations of a "
            f"'{ROBOT}' robot."
        )
    chambers = chamber_count(info.get("features", {}).get("action", {}).get("names") or [])
    if max(chambers, CHAMBERS.get(twin.device, 1)) > 1:
        raise InputError(
            f"{folder}: demonstrations are measurements of fingers of one chamber alone, and this body has"
            " several; compare it by a bench recording (--recording=)."
        )
    faults = demonstration_faults(folder, twin, info.get("fps"))
    if faults:
        raise InputError(faults[0])
    joints = joint_count(len(info["features"]["observation.state"]["names"]))
    if joints != station.joints:
        raise InputError(
            f"{folder / 'meta' / 'info.json'}: the arm has {joints} joints, and that of {file or 'the paper'}"
            f" {station.joints}; lay the station.yaml in which they were recorded beside it."
        )


def task_of(instruction: str, folder: Path) -> str:
    """The task whose own instruction this is, or the only one that it names.

    Raises:
        InputError: it is none's.
    """
    from pneutac_sim.world.tasks import make_task

    words = set(re.findall(r"\w+", instruction.lower()))
    own = [n for n in task_names() if make_task(n).description == instruction]
    named = own or [n for n in task_names() if n in words]
    if len(named) == 1:
        return named[0]
    raise InputError(
        f"{folder}: the instruction '{instruction}' names no task; say with task= which of "
        f"{', '.join(task_names())} stood in front of the robot."
    )
