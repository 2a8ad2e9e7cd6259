"""What a robot adds to the datasets that LeRobot records here: its station, and the rate of each episode.

`lerobot_inside.LeRobotHooks` notices the episodes; `EpisodeHooks` says what is done then.
"""

import contextlib
import json
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from weakref import ref

from lerobot_robot_pneutac.lerobot_inside import LeRobotHooks
from lerobot_robot_pneutac.options import station_of
from lerobot_robot_pneutac.robots.base_robot import BaseRobot
from pneutac_sim.errors import InputError
from pneutac_sim.files import whole
from pneutac_sim.pace import (
    DONE,
    OUTCOME_FILE,
    PACE_FILE,
    Pace,
    faster_than,
    read_outcomes,
    read_pace,
    short_of,
)

logger = logging.getLogger(__name__)


class EpisodeHooks:
    """Adds station and pace to the dataset that LeRobot records here, and writes its `info.json` whole.

    While the robot lives, a new dataset of its type has its rate, or is refused as its `info.json` is begun.

    Args:
        control_hz: of the robot, at which the dataset is to be recorded.
        robot: its method `announced` is called for episodes; a dataset knows it by its `name`.
        waits: the robot stands still between frames, as a simulated one does: a slow loop makes its episodes
            shorter and their motions no faster, so that only the pace of a loop that was too fast is stored.
    """

    def __init__(self, control_hz: int, robot: BaseRobot, waits: bool = False):
        self._control_hz, self._robot, self._waits = control_hz, ref(robot), waits
        self._times_s: list[float] | None = None
        self._lerobot = LeRobotHooks(self._announced, self._write_json)
        self._lerobot.install()

    def connect(self) -> None:
        self._lerobot.listen()

    def disconnect(self) -> None:
        self._lerobot.ignore()

    def observed(self) -> None:
        if self._times_s is not None:
            self._times_s.append(time.perf_counter())

    def _announced(self, begins: bool) -> None:
        if begins:
            self._times_s = []
        if (robot := self._robot()) is not None:
            robot.announced(begins)

    def _write_json(self, data: dict, fpath: Path) -> None:
        """In place of LeRobot's, which empties the old file and writes it again after every episode.

        A kill meanwhile loses the features' names and the frame rate, which nothing else has. `pneutac
        repair` finds all the rest.

        Raises:
            InputError: a dataset of this robot is begun at another rate.
        """
        fpath = Path(fpath)
        begun = fpath.name == "info.json" and not fpath.exists()
        robot = self._robot()
        ours = begun and robot is not None and data.get("robot_type") == robot.name
        if ours and data["fps"] != self._control_hz:
            with contextlib.suppress(OSError):
                fpath.parent.parent.rmdir()  # LeRobot has made it, and would refuse it next time
            raise InputError(self._other_rate(data["fps"]))
        frames = data.get("total_frames", 0) - _frames(fpath) if fpath.name == "info.json" else 0
        with whole(fpath) as part:
            part.write_text(json.dumps(data, indent=4, ensure_ascii=False), encoding="utf-8")
        if frames > 1 and self._times_s is not None and len(self._times_s) >= frames:
            if robot is not None:
                store_station(robot, fpath.parent)
                self._store_outcome(fpath.parent, data["total_episodes"] - 1, robot.outcome)
            self._store_pace(fpath.parent, data["total_episodes"] - 1, data["fps"], self._times_s[:frames])
        if frames:
            self._times_s = None
            if data["fps"] != self._control_hz:
                logger.warning("%s", self._other_rate(data["fps"]))

    def _other_rate(self, fps: float) -> str:
        return (
            f"The dataset has {fps} frames per second and the robot's control rate is {self._control_hz} Hz;"
            f" record at --dataset.fps={self._control_hz}, or give a station.yaml with control_hz: {fps}."
        )

    def _store_pace(self, meta: Path, episode: int, fps: float, times_s: list[float]) -> None:
        pace = replace(Pace.of(times_s, fps), simulated=self._waits)
        short, fast = short_of(pace, fps), faster_than(pace, fps)
        if self._waits and short:
            logger.warning(
                "Episode %d ran at %.1f Hz and not at %g, so its %d frames are %.1f s of the simulated world;"
                " where that is too short, give a longer --dataset.episode_time_s.",
                *(episode, pace.achieved_hz, fps, len(times_s), len(times_s) / fps),
            )
        elif self._waits and fast:
            logger.warning(
                "Episode %d ran at %.1f Hz and not at %g, so its %d frames are %.1f s of the simulated world,"
                " in which the policy acted less often than at %g Hz; leave out --interpolation_multiplier.",
                *(episode, pace.achieved_hz, fps, len(times_s), len(times_s) / fps, fps),
            )
        elif short or fast:
            logger.warning(
                "Episode %d ran at %.1f Hz and not at %g: its motions are stored as %s than they were.",
                *(episode, pace.achieved_hz, fps, "faster" if short else "slower"),
            )
        if self._waits and not fast:
            return
        _add(meta / PACE_FILE, read_pace, episode, pace, vars)

    def _store_outcome(self, meta: Path, episode: int, outcome: str | None) -> None:
        if outcome is None:
            return
        if outcome != DONE:
            logger.warning("Episode %d failed: %s. `pneutac augment` sets it aside.", episode, outcome)
        _add(meta / OUTCOME_FILE, read_outcomes, episode, outcome, str)


def _add(file: Path, read: Callable[[Path], dict], episode: int, value, plain: Callable) -> None:
    """Adds an episode's entry to a file of `meta`; a damaged one is no reason to lose the episode."""
    try:
        stored = {**read(file.parent), episode: value}
    except InputError as e:
        logger.warning("%s", e)
        return
    content = {str(k): plain(v) for k, v in sorted(stored.items())}
    with whole(file) as part:
        part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def store_station(robot: BaseRobot, meta: Path) -> None:
    """Leaves the station that a robot was given in its dataset's folder `meta`, for all who replay it.

    A real robot's may be of its limits and rate alone, with another arm: that is not left.
    """
    station = station_of(robot.config.station)
    if robot.config.station is not None and station.joints == robot.config.joints:
        station.save(meta)


def _frames(info: Path) -> int:
    """Frames that an `info.json` counts; 0 where there is none yet."""
    return json.loads(info.read_text(encoding="utf-8")).get("total_frames", 0) if info.is_file() else 0
