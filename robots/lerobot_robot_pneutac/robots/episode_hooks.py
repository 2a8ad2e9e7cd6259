"""What a robot adds to LeRobot's commands: station and rate of episodes in datasets, the rate of every run.

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

from lerobot_robot_pneutac.lerobot_inside import LeRobotHooks, paced
from lerobot_robot_pneutac.options import station_of
from lerobot_robot_pneutac.robots.base_robot import BaseRobot
from pneutac_sim.errors import InputError
from pneutac_sim.files import whole, write_json
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
        self._acted_s: list[float] | None = []  # of a run without announced episodes
        self._lerobot = LeRobotHooks(self._announced, self._write_json)
        self._lerobot.install()

    def connect(self) -> None:
        self._acted_s = []
        self._lerobot.listen()

    def disconnect(self) -> None:
        """Logs at which rate actions came where no episode was recorded, as of lerobot-replay."""
        self._lerobot.ignore()
        times_s, self._acted_s = self._acted_s or [], []
        if not times_s or times_s[-1] - times_s[0] < 1 or (self._waits and not paced()):
            return  # of less than a second there is no rate; a simulated robot may go as fast as it can
        hz, pace = self._control_hz, Pace.of(times_s, self._control_hz)
        came = f"{len(times_s)} actions came at {pace.achieved_hz:.2f} Hz"
        if short_of(pace, hz):
            remedy = "free the computer, or give a station.yaml with a lower control_hz"
            logger.warning("%s and not at %g%s; %s.", came, hz, _late(pace), remedy)
        elif faster_than(pace, hz):
            remedy = "or a station.yaml with the control_hz that the actions are for"
            logger.warning("%s and not at %g%s; give --fps=%g, %s.", came, hz, _late(pace), hz, remedy)
        else:
            logger.info("%s%s.", came, _late(pace))

    def acted(self) -> None:
        """An action was carried out; not a pose, which LeRobot sends at a rate of its own."""
        if self._acted_s is not None:
            self._acted_s.append(time.perf_counter())

    def observed(self) -> None:
        if self._times_s is not None:
            self._times_s.append(time.perf_counter())

    def _announced(self, begins: bool) -> None:
        if begins:
            self._times_s, self._acted_s = [], None
        if (robot := self._robot()) is not None:
            robot.announced(begins)

    def _write_json(self, data: dict, fpath: Path) -> None:
        """In place of LeRobot's, which empties the old file and writes it again after every episode.

        A kill meanwhile loses the features' names and the frame rate, which nothing else has. `pneutac
        repair` finds all the rest.

        Raises InputError: a dataset of this robot is begun at another rate.
        """
        fpath = Path(fpath)
        begun = fpath.name == "info.json" and not fpath.exists()
        robot = self._robot()
        ours = begun and robot is not None and data.get("robot_type") == robot.name
        if ours and data["fps"] != self._control_hz:
            with contextlib.suppress(OSError):
                fpath.parent.parent.rmdir()  # LeRobot has made it, and would refuse it next time
            raise InputError(self._other_rate(data["fps"]))
        frames = 0
        if fpath.name == "info.json":
            before = json.loads(fpath.read_text(encoding="utf-8")) if fpath.is_file() else {}
            frames = data.get("total_frames", 0) - before.get("total_frames", 0)
        with whole(fpath) as part:
            part.write_text(json.dumps(data, indent=4, ensure_ascii=False), encoding="utf-8")
        if frames > 1 and self._times_s is not None and len(self._times_s) >= frames:
            if robot is not None:
                store_station(robot, fpath.parent)
                self._store_outcome(fpath.parent, data["total_episodes"] - 1, robot.outcome)
            films = any(f.get("dtype") == "video" for f in data.get("features", {}).values())
            number, times_s = data["total_episodes"] - 1, self._times_s[:frames]
            self._store_pace(fpath.parent, number, data["fps"], times_s, films)
        if frames:
            self._times_s = None
            if data["fps"] != self._control_hz:
                logger.warning("%s", self._other_rate(data["fps"]))

    def _other_rate(self, fps: float) -> str:
        return (
            f"The dataset has {fps} frames per second and the robot's control rate is {self._control_hz} Hz;"
            f" record at --dataset.fps={self._control_hz}, or give a station.yaml with control_hz: {fps}."
        )

    def _store_pace(self, meta: Path, episode: int, fps: float, times_s: list[float], films: bool) -> None:
        pace = replace(Pace.of(times_s, fps), simulated=self._waits)
        short, fast = short_of(pace, fps), faster_than(pace, fps)
        ran = f"Episode {episode} ran at {pace.achieved_hz:.2f} Hz"
        world = f"so its {len(times_s)} frames are {len(times_s) / fps:.1f} s of the simulated world"
        if not (short or fast):
            logger.info("%s%s.", ran, _late(pace))
        else:
            if not self._waits:
                follows = f"so its motions are stored as {'faster' if short else 'slower'} than they were"
            elif short:
                remedy = "the robot a less busy computer"
                remedy += ", --dataset.streaming_encoding=true if it is not given" if films else ""
                follows = f"{world}; give {remedy}, or a longer --dataset.episode_time_s"
            else:
                less = f"in which the policy acted less often than at {fps:g} Hz"
                follows = f"{world}, {less}; leave out --interpolation_multiplier"
            logger.warning("%s and not at %g%s, %s.", ran, fps, _late(pace), follows)
        if self._waits and not fast:
            return
        _add(meta / PACE_FILE, read_pace, episode, pace, vars)

    def _store_outcome(self, meta: Path, episode: int, outcome: str | None) -> None:
        if outcome is None:
            return
        if outcome != DONE:
            logger.warning("Episode %d failed: %s. `pneutac augment` sets it aside.", episode, outcome)
        _add(meta / OUTCOME_FILE, read_outcomes, episode, outcome, str)


def _late(pace: Pace) -> str:
    return f" ({pace.late_frames} late, the longest pause {pace.longest_s:.2f} s)"


def _add(file: Path, read: Callable[[Path], dict], episode: int, value, plain: Callable) -> None:
    """Adds an episode's entry to a file of `meta`; a damaged one is no reason to lose the episode."""
    try:
        stored = {**read(file.parent), episode: value}
    except InputError as e:
        logger.warning("%s", e)
        return
    write_json(file, {str(k): plain(v) for k, v in sorted(stored.items())})


def store_station(robot: BaseRobot, meta: Path) -> None:
    """Leaves the station that a robot was given in its dataset's folder `meta`, for all who replay it.

    A real robot's may be of its limits and rate alone, with another arm: that is not left.
    """
    station = station_of(robot.config.station)
    if robot.config.station is not None and station.joints == robot.config.joints:
        station.save(meta)
