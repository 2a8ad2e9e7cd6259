"""Augmentation of demonstrations: a few recorded ones in, many new ones out, as a LeRobotDataset.

`augment_guided` carries each new demonstration out in the world: by a controller made of the recorded ones,
by the task's expert, or planned and guided by the recorded touch. `naive.augment_naive` varies the recordings
without a simulator.
"""

import hashlib
import json
import os
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr
from dataclasses import asdict, dataclass
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.dataset_tools import delete_episodes
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.lerobot_inside import load_info, write_info
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import ANSWER_DELAY
from pneutac_datasets.demonstrations.augment.episode import AugmentSetup
from pneutac_datasets.demonstrations.augment.library import lagged_answers
from pneutac_datasets.demonstrations.augment.reference import Reference
from pneutac_datasets.demonstrations.augment.scene import Scene
from pneutac_datasets.demonstrations.augment.work import Work, check, generator, make_episode, make_scene
from pneutac_datasets.demonstrations.card import write_card
from pneutac_datasets.demonstrations.episodes import (
    TACTILE,
    Episode,
    demonstration_features,
    further_features,
    load_episode,
    readable,
    save_episode,
)
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_datasets.demonstrations.info import check_new, work_folder
from pneutac_datasets.demonstrations.naive import augment_naive
from pneutac_datasets.demonstrations.replay.imprint import imprint_centres_mm
from pneutac_datasets.demonstrations.save import EncodedVideos, create_dataset, quiet_encoders, written
from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions, faults_named, process_pool, run_pieces
from pneutac_sim.features import Places
from pneutac_sim.files import locked, write_text
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.progress import Progress, no_progress

PROVENANCE = "provenance.jsonl"  # in the dataset's folder `meta`
VIDEOS_MB = 1  # a new video file begins there, since LeRobot copies the last one with every episode
LOOK_S = 0.2  # between two looks whether the next demonstration is there
WRITING = "writing the dataset"
RECORDED = "recorded"  # method of the copies of recorded demonstrations


@dataclass(frozen=True)
class NewDataset:
    """What an augmentation writes, and how it is made."""

    root: Path  # its folder; `<root>.work` holds what is finished until all is
    repo_id: str  # its name
    episodes: int  # number of new demonstrations
    executor: ExecutorOptions  # where they are made
    checks: int = 0  # of them, that material points carry out once more, see `work.check`
    # of the frames that are to be recorded ones: as many copies of the source are merged into it, so that a
    # trainer that draws frames evenly mixes by it
    real_share: float = 0.0
    device: str = "cpu"  # of PyTorch, on which `worlds` are stepped together by the library
    worlds: int = 0  # their number; 0 for a world in each process


def read_references(
    recorded: Recorded, repo_id: str, sensor: TactileSensor | None = None
) -> tuple[LeRobotDatasetMetadata, list[Reference]]:
    """The recorded demonstrations that have not failed, without their images.

    With the twin's `sensor` the images are read, for the middles of the imprints.

    Raises:
        InputError: it is damaged, its features are not those of the robot, or an episode is not finite.
    """
    recorded.refuse_damaged()
    with readable(recorded.folder):
        meta = LeRobotDatasetMetadata(repo_id, recorded.folder)
        demonstration_features(meta)
        dataset = LeRobotDataset(repo_id, recorded.folder, video_backend="pyav")
    references, places = [], Places.of(recorded.chambers)
    for i in recorded.used:
        (state, action), task = recorded.episodes[i], meta.episodes[i]["tasks"][0]
        area = without_specks(state[:, places.area])
        r = Reference(i, state[:, places.ee], area, action, task, control_hz=meta.fps)
        if sensor is not None:
            with readable(recorded.folder):
                images = load_episode(dataset, i).images
            r.centre_mm = imprint_centres_mm(images, r.area, sensor)
        references.append(r)
    return meta, references


def augment_guided(
    meta: LeRobotDatasetMetadata, setup: AugmentSetup, out: NewDataset, progress: Progress = no_progress
) -> dict:
    """Writes a LeRobotDataset of new demonstrations that merges with its source.

    Args:
        meta: of the source, from `read_references`.
        setup: what every demonstration depends on.
        out: the new dataset.
        progress: is called with the stage, and how many of how many are done.

    Returns:
        `attempts`, `kept`, `rejected` (reason to count), `provenance` (a dict each), `seconds` by part,
        `scenes`, `wall_s`; with checks also `checks`, an `Agreement` each.

    Raises:
        InputError: the output exists, an unfinished run is another one, or a demonstration cannot be made.
    """
    checks, episodes, began = min(out.checks, out.episodes), out.episodes, time.monotonic()
    work = Work(work_folder(out.root))
    part = out.root.with_name(out.root.name + ".part")
    if out.root.exists() and work.folder.exists():
        return _tidy_up(work, out.root, meta, setup, episodes, began) | _checked(work, checks)
    check_new(out.root, out.repo_id)
    together = {"device": out.device} if out.worlds else {}
    work.open(_run(meta, setup) | ({"real_share": out.real_share} if out.real_share else {}) | together)
    with locked(work.folder, wait_s=0.0):
        return _make_and_write(meta, setup, out, work, part, progress, began)


def _make_and_write(
    meta: LeRobotDatasetMetadata,
    setup: AugmentSetup,
    out: NewDataset,
    work: Work,
    part: Path,
    progress: Progress,
    began: float,
) -> dict:
    checks, episodes = min(out.checks, out.episodes), out.episodes
    scenes = _find_scenes(work, setup, out.executor, progress) if setup.method == "planner" else []
    files, new = [work.episode_file(k) for k in range(episodes)], work.folder / "dataset"
    parts, ended, failed = {}, threading.Event(), threading.Event()
    with ThreadPoolExecutor(1) as writer:
        columns = meta, setup.references, work, episodes
        writing = writer.submit(_write, *columns, new, out.repo_id, ended, failed, progress)
        try:
            if out.worlds:
                parts = _make_together(setup, work, files, out, progress)
            else:
                make, logs = partial(make_episode, setup, work.folder, scenes), work.folder / "logs"
                run_pieces(make, files, logs, out.executor, progress, "making demonstrations")
        except BaseException:
            failed.set()
            raise
        finally:
            ended.set()
        spent = time.monotonic()
        writing.result()
    written = time.monotonic()
    used = [r.source for r in setup.references]
    copies = _merge(new, part, out.repo_id, meta, used, out.real_share)
    made = [work.load_spent(k) for k in range(episodes)]
    provenance = [line for line, _ in made] + copies
    seconds = {name: sum(s[name] for _, s in made) for name in made[0][1]}
    seconds |= {"writing": written - spent, "merging": time.monotonic() - written} | parts
    check(work, setup, checks, progress)
    agreements = _checked(work, checks)
    delay = lagged_answers(setup.references)[1] if setup.method == "library" else None
    finish(part, out.root, provenance, delay)
    shutil.rmtree(work.folder)
    return _summary(provenance, seconds, scenes, began) | agreements | {ANSWER_DELAY: delay or 0}


def _checked(work: Work, checks: int) -> dict:
    """The agreements that were found, for the summary."""
    found = [json.loads(work.check_file(k).read_text()) for k in range(checks) if work.check_file(k).exists()]
    return {"checks": found} if found else {}


def _tidy_up(
    work: Work, out_root: Path, meta: LeRobotDatasetMetadata, setup: AugmentSetup, episodes: int, began: float
) -> dict:
    """Ends a run that was stopped when only its work folder was left to remove."""
    work.open(_run(meta, setup))
    planner = setup.method == "planner"
    scenes = [work.load_scene(i) for i in range(len(setup.references))] if planner else []
    lines = (out_root / "meta" / PROVENANCE).read_text().splitlines()
    provenance = [json.loads(line) for line in lines]
    new = sum(line.get("method") != RECORDED for line in provenance)
    if new != episodes:
        raise InputError(
            f"'{out_root}' holds {new} demonstrations, not {episodes}; give a new folder for them."
        )
    shutil.rmtree(work.folder)
    return _summary(provenance, {}, scenes, began)


def _find_scenes(
    work: Work, setup: AugmentSetup, executor: ExecutorOptions, progress: Progress
) -> list[Scene]:
    files = [work.scene_file(i) for i in range(len(setup.references))]
    make = partial(make_scene, setup, work.folder)
    run_pieces(make, files, work.folder / "logs", executor, progress, "finding the objects")
    return [work.load_scene(i) for i in range(len(files))]


def _make_together(
    setup: AugmentSetup, work: Work, files: list[Path], out: NewDataset, progress: Progress
) -> dict[str, float]:
    """Makes what is missing in a batch of worlds; returns the seconds of this process by part.

    A pool of processes draws, encodes and saves; it starts while the worlds are built.
    """
    missing = [k for k, file in enumerate(files) if not file.exists()]
    if not missing:
        return {}
    from pneutac_datasets.demonstrations.augment.lockstep import Lockstep

    began = time.monotonic()
    workers = min(out.executor.workers or len(os.sched_getaffinity(0)), len(missing))
    with faults_named("Making demonstrations", work.folder), process_pool(workers) as pool:
        for _ in range(workers):
            pool.submit(_start, setup, work.folder)
        lockstep = Lockstep(setup, work, out.device, out.worlds)
        built = time.monotonic()
        lockstep.make(missing, pool, progress, len(files) - len(missing))
    return lockstep.seconds | {"building": built - began, "making": time.monotonic() - built}


def _start(setup: AugmentSetup, folder: Path) -> None:
    """Imports what saving needs, and loads the twin."""
    generator(setup, folder)


def _write(
    meta: LeRobotDatasetMetadata,
    references: list[Reference],
    work: Work,
    episodes: int,
    root: Path,
    repo_id: str,
    ended: threading.Event,
    failed: threading.Event,
    progress: Progress,
) -> None:
    """Writes the demonstrations in order as a dataset, while they are made until `ended` or `failed`."""
    shutil.rmtree(root, ignore_errors=True)
    features = demonstration_features(meta) | further_features(meta)
    out = create_dataset(
        repo_id, root, meta.fps, features, meta.robot_type, bool(meta.video_keys), 1, VIDEOS_MB
    )
    videos = EncodedVideos(out)
    with written(out):
        for k in range(episodes):
            while not work.episode_file(k).exists() and not failed.is_set():
                ended.wait(LOOK_S)
            if failed.is_set():
                return
            columns, videos.films = work.load_columns(k)
            for key in videos.films:
                columns[key] = np.broadcast_to(np.uint8(0), (len(columns[ACTION]), *features[key]["shape"]))
            state, action, images = (columns.pop(key) for key in (OBS_STATE, ACTION, TACTILE))
            task = references[work.load_spent(k)[0]["source"]].task
            save_episode(out, Episode(state, action, images, task, meta.fps), columns)
            if ended.is_set():
                progress(WRITING, k + 1, episodes)
    out.meta.update_chunk_settings(video_files_size_in_mb=meta.video_files_size_in_mb)


def _merge(
    new: Path, part: Path, repo_id: str, meta: LeRobotDatasetMetadata, used: list[int], share: float
) -> list[dict]:
    """Moves a dataset to `part`, with copies of `used` episodes; gives the copies' provenance.

    There are as many as make that share of the frames recorded ones.
    """
    info = load_info(new)
    lengths = sum(meta.episodes[i]["length"] for i in used)
    copies = round(share / (1 - share) * info.total_frames / lengths)
    shutil.rmtree(part, ignore_errors=True)
    if not copies:
        os.replace(new, part)
        return []
    folder, recorded = new.with_name("copies"), Path(meta.root)
    shutil.rmtree(folder, ignore_errors=True)
    with quiet_encoders(), redirect_stderr(StringIO()):  # its own progress bars besides ours
        if left_out := sorted(set(range(meta.total_episodes)) - set(used)):
            whole = LeRobotDataset(meta.repo_id, recorded, video_backend="pyav")
            recorded = Path(delete_episodes(whole, left_out, folder / "used", meta.repo_id).root)
        repeated = _repeated(recorded, meta.repo_id, copies, folder)
        # One file after the other, as LeRobot would copy what it has merged with every dataset that is added.
        separate = {"concatenate_videos": False, "concatenate_data": False}
        aggregate_datasets([repo_id, meta.repo_id], repo_id, [new, repeated], part, **separate)
    return [
        {"episode": k, "method": RECORDED, "source_episode": source}
        for k, source in enumerate(used * copies, info.total_episodes)
    ]


def _repeated(root: Path, repo_id: str, times: int, folder: Path) -> Path:
    """A dataset, in `folder`, of so many copies of one; each is made of two of half as many."""
    if times == 1:
        return root
    parts = [_repeated(root, repo_id, times // 2, folder)] * 2 + [root] * (times % 2)
    aggregate_datasets([repo_id] * len(parts), repo_id, parts, folder / f"{times}")
    return folder / f"{times}"


def augment_without_simulator(
    recorded: Recorded, repo_id: str, out: NewDataset, seed: int, progress: Progress = no_progress
) -> dict:
    """The same by `naive.augment_naive`; the result has the keys of `augment_guided`."""
    began = time.monotonic()
    if out.root.exists():
        raise InputError(f"'{out.root}' exists; give a new folder for dataset '{out.repo_id}'.")
    part = out.root.with_name(out.root.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    augment_naive(recorded, repo_id, part, out.repo_id, out.episodes, seed, progress)
    provenance = [
        {"episode": k, "seed": seed, "source_episode": recorded.used[k % len(recorded.used)]}
        | {"method": "naive"}
        for k in range(out.episodes)
    ]
    finish(part, out.root, provenance)
    return _summary(provenance, {}, [], began)


def _summary(provenance: list[dict], seconds: dict, scenes: list[Scene], began: float) -> dict:
    rejected = [r["reason"] for line in provenance for r in line.get("rejected", ())]
    copies = sum(line.get("method") == RECORDED for line in provenance)
    provenance = provenance[: len(provenance) - copies]
    return {
        "kept": len(provenance),
        "copies": copies,
        "attempts": len(provenance) + len(rejected),
        "rejected": {reason: rejected.count(reason) for reason in sorted(set(rejected))},
        "provenance": provenance,
        "seconds": seconds,
        "scenes": [asdict(scene) for scene in scenes],
        "wall_s": time.monotonic() - began,
    }


def finish(part: Path, out_root: Path, provenance: list[dict], answer_delay: int | None = None) -> None:
    """Adds provenance (a dict an episode) and card to a whole dataset and gives it its name, in one step.

    `answer_delay`: frames by which the demonstrator answers a touch late, for policies; only of the library.
    """
    if answer_delay is not None:
        info = load_info(part)
        action = info.features[ACTION]
        action["info"] = {**(action.get("info") or {}), ANSWER_DELAY: answer_delay}
        write_info(info, part)
    write_text(part / "meta" / PROVENANCE, "".join(json.dumps(line) + "\n" for line in provenance))
    write_card(part)
    os.replace(part, out_root)


def _run(meta: LeRobotDatasetMetadata, setup: AugmentSetup) -> dict:
    """What must be equal for two runs to make the same demonstrations; their number may differ."""
    digest = hashlib.sha256()
    for r in setup.references:
        centres = () if r.centre_mm is None else r.centre_mm
        for x in (r.flange_m, r.area, r.action, centres):
            digest.update(np.ascontiguousarray(x).tobytes())
    return {
        "dataset": meta.repo_id,
        "demonstrations": digest.hexdigest(),
        "task": setup.task,
        "twin": None if setup.twin is None else str(setup.twin),
        "fidelity": setup.fidelity,
        "station": asdict(setup.where),
        "conditions": setup.conditions,
        "method": setup.method,
        **({"planner": asdict(setup.planner)} if setup.method == "planner" else {}),
        **({} if setup.method == "planner" else {"start_range_m": setup.start_range_m}),
        **({"start_width": setup.start_width} if setup.start_width else {}),
        "seed": setup.seed,
        "attempts": setup.attempts,
        "files": 8,  # version of the work folder's files and of the library
        "candidates": setup.candidates,
        **({"tactile_points": True} if setup.tactile_points else {}),
        **({"cameras": setup.cameras} if setup.cameras else {}),
    }
