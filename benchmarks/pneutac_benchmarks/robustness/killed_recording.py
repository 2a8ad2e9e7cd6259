"""A recording by LeRobot's writer that is killed at random moments, repaired, and gone on with."""

import contextlib
import multiprocessing
import os
import random
import signal
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from lerobot_robot_pneutac.robots.episode_hooks import EpisodeHooks
from pneutac_benchmarks.robustness.outcome import Outcome
from pneutac_datasets.demonstrations.repair import repair_dataset
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, IMAGE_NAME, STATE_NAMES

IMAGES = f"observation.images.{IMAGE_NAME}"
WITHIN_S = 0.8  # latest moment of a kill after the recording began: several episodes
SIZE = (64, 64, 3)  # the least that the video's encoder takes


def episode_length(episode: int) -> int:
    """Frames of the episode of this number."""
    return 8 + episode % 5


class _Robot:
    name = "pneutac"


def grey(episode: int) -> int:
    """Grey level of all its images, other than its neighbours'."""
    return 20 + 37 * episode % 200


def record(root: Path, video: bool, resume: bool, saved) -> None:
    """Records without end; sends its number of episodes whenever LeRobot says that one is saved."""
    from lerobot.datasets import LeRobotDataset

    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    robot = _Robot()
    EpisodeHooks(15, robot).connect()  # as a robot that connects
    features = {
        "observation.state": {"dtype": "float32", "shape": (len(STATE_NAMES),), "names": list(STATE_NAMES)},
        "action": {"dtype": "float32", "shape": (len(ACTION_NAMES),), "names": list(ACTION_NAMES)},
        IMAGES: {
            "dtype": "video" if video else "image",
            "shape": SIZE,
            "names": ["height", "width", "channels"],
        },
    }
    if resume:
        dataset = LeRobotDataset.resume("local/killed", root=root, image_writer_threads=2)
    else:
        dataset = LeRobotDataset.create(
            "local/killed", 15, features, root=root, use_videos=video, image_writer_threads=2
        )
    saved.send(dataset.meta.total_episodes)
    while True:
        episode = dataset.meta.total_episodes
        for _ in range(episode_length(episode)):
            state = np.full(len(STATE_NAMES), episode, np.float32)
            image = np.full(SIZE, grey(episode), np.uint8)
            dataset.add_frame(
                {"observation.state": state, "action": state[:4], IMAGES: image, "task": "press"}
            )
        dataset.save_episode()
        saved.send(dataset.meta.total_episodes)


def kill_recordings(work: Path, kills: int, seed: int = 0) -> Outcome:
    """Kills, repairs and resumes; half of the datasets hold videos, half images.

    Args:
        work: an empty folder.
        kills: number of kills in all; a new dataset begins after each ten.
        seed: of the moments.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "lerobot.datasets"])
    random_ = random.Random(seed)
    broken, finished, repair_s = [], 0, 0.0
    for kill in range(kills):
        begins, video = kill % 10 < 2, kill % 2 == 1
        root = work / f"{'video' if video else 'images'}{kill // 10}"
        listens, saved = context.Pipe(duplex=False)
        process = context.Process(target=record, args=(root, video, not begins, saved), daemon=True)
        process.start()
        saved.close()
        episodes = _kill_at(process, listens, random_.uniform(0, WITHIN_S))
        if episodes is None or process.exitcode != -signal.SIGKILL:
            broken.append(f"kill {kill}: the recording could not be begun or gone on with")
            continue
        started = time.process_time()
        try:
            whole = repair_dataset(root).episodes
        except InputError as e:
            broken.append(f"kill {kill}: {e}")
            continue
        repair_s = max(repair_s, time.process_time() - started)
        finished += episodes
        broken += [f"kill {kill}: {text}" for text in _check(root, episodes, whole)]
    return Outcome(
        "SIGKILL of LeRobot's writer at a random moment, `pneutac repair`, resumed offline",
        kills,
        tuple(broken),
        f"{finished} finished episodes, the longest repair {repair_s:.1f} s of processor time",
    )


def _kill_at(process, listens, moment_s: float) -> int | None:
    """Kills some time after the recording began; returns how many episodes it called saved."""
    episodes = None
    with contextlib.suppress(EOFError):  # it ended by itself
        episodes = listens.recv()
        time.sleep(moment_s)
    process.kill()
    process.join()
    with contextlib.suppress(EOFError):
        while True:
            episodes = listens.recv()
    return episodes


def _check(root: Path, episodes: int, whole: int) -> list[str]:
    """What is missing or other in a repaired dataset."""
    from lerobot.datasets import LeRobotDataset

    if whole < episodes:
        return [f"{episodes - whole} of {episodes} finished episodes are lost"]
    if not whole:
        return []
    dataset = LeRobotDataset("local/killed", root=root, video_backend="pyav")
    meta = dataset.meta
    rows = [row for file in sorted((root / "data").rglob("*.parquet")) for row in _rows(file)]
    wanted = [(e, i, e) for e in range(whole) for i in range(episode_length(e))]
    problems = [] if rows == wanted else ["rows are other than those that were recorded"]
    if meta.total_episodes != whole or meta.total_frames != len(wanted):
        problems.append("info.json counts other episodes or frames")
    for row in list(meta.episodes)[-3:]:
        for index in (row["dataset_from_index"], row["dataset_to_index"] - 1):
            level = 255 * float(dataset[index][IMAGES].mean())
            if abs(level - grey(row["episode_index"])) > 6:  # what a video loses, far below a neighbour's
                problems.append(f"episode {row['episode_index']} shows another episode's images")
    return problems


def _rows(file: Path) -> list[tuple]:
    table = pq.read_table(file, columns=["episode_index", "frame_index", "action"]).to_pylist()
    return [(row["episode_index"], row["frame_index"], row["action"][0]) for row in table]
