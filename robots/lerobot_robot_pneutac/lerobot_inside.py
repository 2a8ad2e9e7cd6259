"""All that PneuTac uses of LeRobot's datasets and commands beyond what their packages export.

Tried on LeRobot 0.6.1 (`TRIED_ON`). A new LeRobot is tried by the tests of this module's users: episode hooks
(`robots.episode_hooks`) and the repair of killed recordings (`pneutac_datasets.demonstrations.repair`). What
would make each part superfluous stands in docs/upstream.
"""

import importlib
import importlib.metadata
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import override

from pneutac_sim.errors import InputError

TRIED_ON = "0.6.1"
KNOWN = TRIED_ON.rpartition(".")[0]  # series of LeRobot whose inside `LeRobotHooks` knows
# So lerobot-record and lerobot-rollout announce that an episode begins, and that one has ended.
BEGINS, ENDS = "Recording episode", ("Reset the environment", "Stop recording")

logger = logging.getLogger(__name__)


class LeRobotHooks(logging.Handler):
    """Hooks into LeRobot, which has none of its own.

    LeRobot stores frame / fps as a frame's time, and observes a robot in the pause between episodes too. What
    it announces in the log, and how many frames it counts, show which observations belong to an episode: the
    first ones after the last announcement. It makes the robot, then the dataset, and connects the robot last.

    `announced` is called with whether an episode begins (or else has ended), `write_json` in place of the
    function that writes the files of a dataset's `meta`.
    """

    def __init__(self, announced: Callable[[bool], None], write_json: Callable[[dict, Path], None]):
        super().__init__(logging.INFO)
        self._announced, self._write_json, self._warned = announced, write_json, False

    def install(self) -> bool:
        """Whether LeRobot's datasets are in use here; they are written by `write_json` from now on.

        In LeRobot's client of remote inference every observation is used from now on.
        """
        io_utils = sys.modules.get("lerobot.datasets.io_utils")
        client = sys.modules.get("lerobot.async_inference.helpers")
        if io_utils is None and client is None:
            return False
        version = importlib.metadata.version("lerobot")
        if not version.startswith(f"{KNOWN}."):
            if not self._warned:
                logger.warning(
                    "LeRobot %s is unknown to this version of PneuTac, so the rate of datasets is not"
                    " checked, no station and no pace are stored with them, and a policy server may drop"
                    " observations of slow changes; install LeRobot %s, or a newer PneuTac.",
                    *(version, KNOWN),
                )
            self._warned = True
            return False
        if client is not None:
            client.TimedObservation.must_go = property(lambda _: True, _must_go)
        if io_utils is None:
            return False
        io_utils.write_json = self._write_json
        sys.modules["lerobot.datasets.dataset_reader"].load_nested_dataset = _load_episodes
        return True

    def listen(self) -> None:
        """From now on episodes are noticed, where the hooks can be installed."""
        if self.install():
            logging.getLogger().addHandler(self)

    def ignore(self) -> None:
        logging.getLogger().removeHandler(self)

    @override
    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if message.startswith((BEGINS, *ENDS)):
            self._announced(message.startswith(BEGINS))


def _must_go(observation, _) -> None:
    """Whatever the client sets, the server shall use an observation, and none is dropped as similar.

    The server drops one whose state lies within 1 of the last that it used, by the norm over all numbers. In
    rad, m and kPa few motions are as large, and creep is not; the robot ran out of actions and waited.
    """
    vars(observation)["must_go"] = True


def paced() -> bool:
    """Whether a command of LeRobot's runs here; those keep time by the clock."""
    program = Path(sys.argv[0])
    return program.name.startswith("lerobot-") or "lerobot" in program.parts


def _load_episodes(data: Path, features=None, episodes: list[int] | None = None):
    """In place of LeRobot's, which says of an episode that is not there that "train" has no data.

    Raises:
        InputError: the dataset has no such episode.
    """
    total = json.loads((data.parent / "meta" / "info.json").read_text(encoding="utf-8"))["total_episodes"]
    if missing := [e for e in episodes or () if not 0 <= e < total]:
        raise InputError(f"{data.parent} has no episode {missing[0]}; give one of 0 to {total - 1}.")
    io_utils = sys.modules["lerobot.datasets.io_utils"]
    return io_utils.load_nested_dataset(data, features=features, episodes=episodes)


# Functions by which LeRobot describes what it has recorded, by their module in `lerobot.datasets`; repair and
# augmentation call them again. They are imported when asked for: robots do without, and they take seconds.
_OF_DATASETS = {
    "DatasetInfo": "utils",
    "aggregate_stats": "compute_stats",
    "cast_stats_to_numpy": "io_utils",
    "compute_episode_stats": "compute_stats",
    "get_hf_features_from_features": "feature_utils",
    "get_video_info": "video_utils",
    "load_info": "io_utils",
    "update_chunk_file_indices": "utils",
    "write_info": "io_utils",
    "write_stats": "io_utils",
    "write_tasks": "io_utils",
}


def __getattr__(name: str):
    if name not in _OF_DATASETS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"lerobot.datasets.{_OF_DATASETS[name]}"), name)
