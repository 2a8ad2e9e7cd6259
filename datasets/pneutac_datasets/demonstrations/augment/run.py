"""Augmentation of demonstrations: a few recorded ones in, many new ones out, as a LeRobotDataset.

`augment_guided` carries each new demonstration out in the world: by a controller made of the recorded ones,
by the task's expert, or planned and guided by the recorded touch. `naive.augment_naive` varies the recordings
without a simulator.

Each finished piece is one file of a work folder, which appears whole or not at all. What is there need not be
made again, so a run that was killed goes on where it stopped, with any number of workers, and pieces made
twice are equal.

Demonstrations may be carried out once more by material points: the same start, object and actions, while
finger and gel deform otherwise. The last action goes on for a second where the task takes longer.
"""

import hashlib
import json
import os
import shutil
import threading
import time
import zlib
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, redirect_stderr
from dataclasses import asdict, dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.dataset_tools import delete_episodes
from lerobot.utils.constants import ACTION, OBS_STATE
from numpy.lib.npyio import NpzFile

from lerobot_robot_pneutac.lerobot_inside import load_info, write_info
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import ANSWER_DELAY
from pneutac_datasets.demonstrations.augment.episode import CONTACT, Attempt, AugmentSetup, Generator, Sensed
from pneutac_datasets.demonstrations.augment.library import lagged_answers
from pneutac_datasets.demonstrations.augment.reference import EXTRA_STEPS, frames_at
from pneutac_datasets.demonstrations.augment.scene import Scene
from pneutac_datasets.demonstrations.card import write_card
from pneutac_datasets.demonstrations.episodes import (
    POINTS,
    TACTILE,
    Episode,
    demonstration_features,
    further_features,
    save_episode,
)
from pneutac_datasets.demonstrations.reading import check_new, work_folder
from pneutac_datasets.demonstrations.save import (
    EncodedVideos,
    Film,
    create_dataset,
    decode,
    encode,
    quiet_encoders,
    written,
)
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, faults_named, no_progress, process_pool, run_pieces
from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.files import LOCK, claim, locked, whole, write_json, write_text
from pneutac_sim.pace import PROVENANCE
from pneutac_sim.twin import Twin, twin_digest
from pneutac_sim.world.base import Variation, converged, solved_joints
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

VIDEOS_MB = 1  # a new video file begins there, since LeRobot copies the last one with every episode
LOOK_S = 0.2  # between two looks whether the next demonstration is there
WRITING = "writing the dataset"
RECORDED = "recorded"  # method of the copies of recorded demonstrations
FEATURE = "feature "  # before the names of a dataset's features


class Work:
    """The folder, next to the output."""

    def __init__(self, folder: Path):
        self.folder = Path(folder)

    def open(self, run: dict) -> None:
        """Begins a run or goes on with the same one; raises InputError where the folder holds other things.

        It is removed when the run has ended.
        """
        file = self.folder / "run.json"
        if not file.exists() and self.folder.is_dir():
            if others := [f.name for f in self.folder.iterdir() if f.suffix != ".part" and f.name != LOCK]:
                raise InputError(
                    f"'{self.folder}' is where this run would be kept until it is whole, and it holds"
                    f" '{min(others)}'; move that folder away, or give another --output.root."
                )
        claim(file, run)

    @property
    def prepared(self) -> Path:
        """File that is there once a process has its world and can make demonstrations."""
        return self.folder / "prepared"

    def scene_file(self, source: int) -> Path:
        return self.folder / f"scene_{source:06d}.json"

    def check_file(self, index: int) -> Path:
        """File of the agreement of one demonstration with material points."""
        return self.folder / f"check_{index:06d}.json"

    def episode_file(self, index: int) -> Path:
        return self.folder / f"episode_{index:06d}.npz"

    def load_scene(self, source: int) -> Scene:
        d = json.loads(self.scene_file(source).read_text())
        return Scene(**d | {"shift_m": tuple(d["shift_m"])})

    @contextmanager
    def _episode(self, index: int) -> Iterator[NpzFile]:
        """A demonstration's file; raises InputError where it is damaged."""
        file = self.episode_file(index)
        try:
            with np.load(file) as d:
                yield d
        except (OSError, EOFError, ValueError, KeyError, BadZipFile, zlib.error) as e:
            raise InputError(f"'{file}' is damaged; delete it, and the same command makes it again.") from e

    def load_spent(self, index: int) -> tuple[dict, dict]:
        """Reads a demonstration's provenance, and the seconds that it took, alone."""
        with self._episode(index) as d:
            return json.loads(str(d["provenance"])), json.loads(str(d["seconds"]))

    def load_episode(self, index: int) -> tuple[Attempt, dict, dict]:
        """Reads a demonstration, its provenance, and the seconds that it took."""
        columns, films = self.load_columns(index)
        columns |= {key: decode(film) for key, film in films.items()}
        state, action, images = (columns.pop(key) for key in (OBS_STATE, ACTION, TACTILE))
        provenance, seconds = self.load_spent(index)
        scores = provenance.get("cost", 0.0), provenance.get("area_rmse", 1.0)
        with self._episode(index) as d:
            values = json.loads(str(d["start"]))
            carried_out = d["carried_out"] if "carried_out" in d.files else None
        seed = values.pop("seed")
        start = seed, Variation(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
        return Attempt(state, action, images, None, *scores, start, columns, carried_out), provenance, seconds

    def load_columns(self, index: int) -> tuple[dict[str, np.ndarray], dict[str, Film]]:
        """Reads a demonstration's features (T, ...), and those that are videos."""
        with self._episode(index) as d:
            found = {key.removeprefix(FEATURE): d[key] for key in d.files if key.startswith(FEATURE)}
            statistics = json.loads(str(d["statistics"]))
        films = {
            key: Film(found.pop(key).tobytes(), {name: np.array(x) for name, x in each.items()})
            for key, each in statistics.items()
        }
        summed = {k: np.cumsum(x, 0, dtype=np.uint8) for k, x in found.items() if x.dtype == np.uint8}
        return found | summed, films

    def save_episode(
        self,
        index: int,
        attempt: Attempt,
        provenance: dict,
        seconds: dict,
        videos: Collection[str] = (),
        fps: int = CONTROL_HZ,
    ) -> None:
        """Writes a demonstration; features in `videos` encoded, other images as changes between frames."""
        columns = {OBS_STATE: attempt.state, ACTION: attempt.action, TACTILE: attempt.images} | attempt.more
        began = time.process_time()
        films = encode({key: columns.pop(key) for key in videos}, fps)
        seconds = seconds | {"encoding": time.process_time() - began}
        columns |= {
            key: np.diff(x, axis=0, prepend=np.zeros_like(x[:1]))
            for key, x in columns.items()
            if x.dtype == np.uint8
        }
        columns |= {key: np.frombuffer(film.data, np.uint8) for key, film in films.items()}
        statistics = {k: {name: x.tolist() for name, x in f.statistics.items()} for k, f in films.items()}
        start = {"seed": attempt.start[0], **asdict(attempt.start[1])}
        texts = {"start": start, "provenance": provenance, "seconds": seconds, "statistics": statistics}
        arrays = {name: np.array(json.dumps(each)) for name, each in texts.items()}
        if attempt.carried_out is not None:
            arrays["carried_out"] = attempt.carried_out
        arrays |= {f"{FEATURE}{key}": values for key, values in columns.items()}
        with whole(self.episode_file(index)) as part, part.open("wb") as f:
            np.savez_compressed(f, **arrays)


# ------------------------------------------------------------------ in a worker process

_made: tuple[Path, Generator] | None = None  # a process' generator, and for which run


def make_scene(setup: AugmentSetup, folder: Path, source: int) -> None:
    """Finds and saves the scene of one reference."""
    write_json(Work(folder).scene_file(source), asdict(generator(setup, folder).scene(source)))


def make_episode(setup: AugmentSetup, folder: Path, scenes: list[Scene], index: int) -> None:
    """Makes and saves the demonstration of an index."""
    makes = generator(setup, folder)
    before, began = _spent(makes), time.process_time()
    attempt, provenance = makes.episode(index, scenes)
    seconds = {k: v - before[k] for k, v in _spent(makes).items()} | {"core": time.process_time() - began}
    video = setup.videos, setup.references[0].control_hz
    Work(folder).save_episode(index, attempt, provenance, seconds, *video)


def save_sensed(setup: AugmentSetup, folder: Path, index: int, sensed: Sensed, provenance: dict) -> None:
    """Adds joints and images to an accepted attempt, and saves it as the demonstration of an index."""
    began, world = time.process_time(), generator(setup, folder).world
    solver, states = world.arm.solver(), sensed.states
    flange_m = states[:, :3] - world.arm.base_m
    converged(solver, flange_m[0])
    shown = np.maximum(np.arange(len(states)) - sensed.start[1].late_touch, 0)
    rows = []
    for at, state, contact in zip(flange_m, states, states[shown, CONTACT], strict=True):
        joints = solved_joints(solver, at, state[3:6], world.dt_s)
        rows.append(np.concatenate([*joints, at, contact, state[8:]]))
    drawn = {t: world.sensor.draw(u) for t, u in sensed.displacement_mm.items()}
    images = np.stack([drawn.get(t, world.sensor.rest_image) for t in shown.tolist()])
    attempt = Attempt(np.array(rows, np.float32), sensed.actions, images, None, 0.0, 1.0, sensed.start)
    seconds = {"core": time.process_time() - began}
    video = setup.videos, setup.references[0].control_hz
    Work(folder).save_episode(index, attempt, provenance, seconds, *video)


def generator(setup: AugmentSetup, folder: Path) -> Generator:
    """That of a run, made once in each process."""
    global _made
    if _made is None or _made[0] != folder:
        _made = folder, Generator(setup)
        Work(folder).prepared.touch()
    return _made[1]


def _spent(g: Generator) -> dict:
    return {**g.gantry.seconds, **g.seconds, "planner_steps": g.gantry.steps}


CHECKED_BY = "mpm"  # the fidelity in which demonstrations are carried out once more
STEP_S = 0.6  # of a control step by material points on one core, until it has been measured


@dataclass(frozen=True)
class Agreement:
    """One demonstration by two fidelities."""

    episode: int  # its number
    success: bool  # whether the task is done there too
    touched: tuple[int, int]  # steps with touch as planned, and as checked
    # root mean square difference of the contact areas, shares of the image, from the first touch of either on
    area_rmse: float
    area_peak: float  # largest contact area as planned, to compare it with
    image_rmse_levels: float  # the same of the tactile images in steps in which either touches, of 255
    seconds: float  # that the check took


def check(work: Work, setup: AugmentSetup, number: int, progress: Progress) -> None:
    """Writes the agreements of the first `number` demonstrations into their work folder; what is there stays.

    `progress` is called with the minutes that are left, and how many steps of how many are done.
    """
    missing = [k for k in range(number) if not work.check_file(k).exists()]
    attempts = {k: work.load_episode(k)[0] for k in missing}
    total, done, began, world = sum(len(a.action) for a in attempts.values()), 0, time.monotonic(), None

    def step() -> None:
        nonlocal done
        each = (time.monotonic() - began) / done if done else STEP_S
        minutes = each * (total - done) / 60
        progress(f"checking with material points, about {minutes:.0f} minutes left", done, total)
        done += 1

    for k, attempt in attempts.items():
        if world is None:
            world = setup.world(fidelity=CHECKED_BY)
            began = time.monotonic()
        write_json(work.check_file(k), asdict(agreement(world, k, attempt, step)))


def agreement(world: World, episode: int, attempt: Attempt, step=lambda: None) -> Agreement:
    """Carries out a demonstration in another world; calls `step` before each of its actions."""
    began = time.monotonic()
    seed, variation = attempt.start
    world.variation = variation
    world.reset(seed)
    areas, errors, planned = [], [], attempt.area
    carried_out = attempt.action if attempt.carried_out is None else attempt.carried_out
    for t, action in enumerate(carried_out):
        step()
        areas.append(world.touch.area)
        if areas[t] > 0 or planned[t] > 0:
            errors.append(np.mean((world.touch.image.astype(float) - attempt.images[t]) ** 2))
        world.step(action)
    for _ in range(frames_at(world.station.control_hz, EXTRA_STEPS)):
        if world.success or world.failure:
            break
        world.step(attempt.action[-1])
    error, felt = np.array(areas) - planned, np.flatnonzero((np.array(areas) > 0) | (planned > 0))
    return Agreement(
        episode,
        bool(world.success and not world.failure),
        (int(np.sum(planned > 0)), int(np.sum(np.array(areas) > 0))),
        float(np.sqrt(np.mean(error[felt[0] :] ** 2))) if len(felt) else 0.0,
        float(planned.max()),
        float(np.sqrt(np.mean(errors))) if errors else 0.0,
        time.monotonic() - began,
    )


# ------------------------------------------------------------------ the whole run


def augment_guided(
    meta: LeRobotDatasetMetadata, setup: AugmentSetup, progress: Progress = no_progress
) -> dict:
    """Writes a LeRobotDataset of new demonstrations with the features of their source.

    Args:
        meta: of the source, from `read_references`.
        setup: what every demonstration depends on.
        progress: is called with the stage, and how many of how many are done.

    Returns:
        `attempts`, `kept`, `rejected` (reason to count), `provenance` (a dict each), `seconds` by part,
        `scenes`, `wall_s`, `earlier` (how many of `kept` a run had made that was stopped); with checks also
        `checks`, an `Agreement` each.

    Raises InputError: the output exists, an unfinished run is another one, or a demonstration cannot be made.
    """
    c, out, began = setup.config, setup.config.output, time.monotonic()
    work, n = Work(work_folder(out.root)), len(setup.references)
    check_new(out.root, out.repo_id)
    work.open(_run(meta, setup))
    with locked(work.folder, wait_s=0.0):
        # It is there where a run was stopped when only its work folder was left to remove.
        ended = out.root.exists()
        earlier = sum(ended or work.episode_file(k).exists() for k in range(c.episodes))
        seconds = {} if ended else _make_and_write(meta, setup, work, progress)
        lines = (out.root / "meta" / PROVENANCE).read_text().splitlines()
        scenes = [work.load_scene(i) for i in range(n) if work.scene_file(i).exists()]
        found = summary_of([json.loads(line) for line in lines], seconds, scenes, began)
        if found["kept"] != c.episodes:
            raise InputError(
                f"'{out.root}' holds {found['kept']} demonstrations, not {c.episodes}; give a new folder for"
                " them."
            )
        checked = [f for f in map(work.check_file, range(c.check_mpm)) if f.exists()]
        checks = {"checks": [json.loads(f.read_text()) for f in checked]} if checked else {}
        shutil.rmtree(work.folder)
    return found | checks | {"earlier": earlier, ANSWER_DELAY: _answer_delay(setup) or 0}


def _answer_delay(setup: AugmentSetup) -> int | None:
    """Frames by which the demonstrator answers a touch late, for policies; only of the library."""
    return lagged_answers(setup.references)[1] if setup.config.method == "library" else None


def _make_and_write(
    meta: LeRobotDatasetMetadata, setup: AugmentSetup, work: Work, progress: Progress
) -> dict[str, float]:
    """Makes what is missing and writes the dataset; returns the seconds by part."""
    c, out = setup.config, setup.config.output
    work.prepared.unlink(missing_ok=True)
    scenes = _find_scenes(work, setup, progress) if c.method == "planner" else []
    files, new = [work.episode_file(k) for k in range(c.episodes)], work.folder / "dataset"
    parts, ended, failed = {}, threading.Event(), threading.Event()
    with ThreadPoolExecutor(1) as writer:
        writing = writer.submit(_write, meta, setup, work, new, ended, failed, progress)
        try:
            if c.device != "cpu":
                parts = _make_together(setup, work, files, scenes, progress)
            else:
                make, logs = partial(make_episode, setup, work.folder, scenes), work.folder / "logs"
                run_pieces(make, files, logs, c, _prepared(work, progress), "making demonstrations")
        except BaseException:
            failed.set()
            raise
        finally:
            ended.set()
        spent = time.monotonic()
        writing.result()
    written = time.monotonic()
    used = [r.source for r in setup.references]
    part = work.folder / "whole"
    copies = _merge(new, part, out.repo_id, meta, used, c.real_share or 0.0)
    made = [work.load_spent(k) for k in range(c.episodes)]
    seconds = {name: sum(s[name] for _, s in made) for name in made[0][1]}
    seconds |= {"writing": written - spent, "merging": time.monotonic() - written} | parts
    check(work, setup, c.check_mpm, progress)
    finish(part, [line for line, _ in made] + copies, setup.station, _answer_delay(setup))
    os.replace(part, out.root)
    return seconds


def _prepared(work: Work, progress: Progress) -> Progress:
    """Progress that names what comes before the first piece: processes start and replay what was recorded."""
    return lambda text, *done: progress(text if work.prepared.exists() else "preparing the worlds", *done)


def _find_scenes(work: Work, setup: AugmentSetup, progress: Progress) -> list[Scene]:
    files = [work.scene_file(i) for i in range(len(setup.references))]
    make, logs = partial(make_scene, setup, work.folder), work.folder / "logs"
    run_pieces(make, files, logs, setup.config, _prepared(work, progress), "finding the objects")
    return [work.load_scene(i) for i in range(len(files))]


def _make_together(
    setup: AugmentSetup, work: Work, files: list[Path], scenes: list[Scene], progress: Progress
) -> dict[str, float]:
    """Makes what is missing in a batch of worlds; returns the seconds of this process by part.

    A pool of processes draws, encodes and saves; it starts while the worlds are built.
    """
    missing = [k for k, file in enumerate(files) if not file.exists()]
    if not missing:
        return {}
    from pneutac_datasets.demonstrations.augment.lockstep import Lockstep

    began = time.monotonic()
    workers = min(setup.config.workers or len(os.sched_getaffinity(0)), len(missing))
    with faults_named("Making demonstrations", work.folder), process_pool(workers) as pool:
        for _ in range(workers):
            pool.submit(_start, setup, work.folder)
        progress("preparing the worlds", len(files) - len(missing), len(files))
        lockstep, save = Lockstep(setup, scenes), partial(save_sensed, setup, work.folder)
        built = time.monotonic()
        lockstep.make(missing, pool, save, progress, len(files) - len(missing))
    return lockstep.seconds | {"building": built - began, "making": time.monotonic() - built}


def _start(setup: AugmentSetup, folder: Path) -> None:
    """Loads the twin before the first demonstration is to be saved."""
    generator(setup, folder)


def _write(
    meta: LeRobotDatasetMetadata,
    setup: AugmentSetup,
    work: Work,
    root: Path,
    ended: threading.Event,
    failed: threading.Event,
    progress: Progress,
) -> None:
    """Writes the demonstrations in order as a dataset, while they are made until `ended` or `failed`."""
    shutil.rmtree(root, ignore_errors=True)
    features = demonstration_features(meta) | further_features(meta)
    how = meta.robot_type, bool(meta.video_keys), 1, VIDEOS_MB
    out = create_dataset(setup.config.output.repo_id, root, meta.fps, features, *how)
    videos, episodes = EncodedVideos(out), setup.config.episodes
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
            task = setup.references[work.load_spent(k)[0]["source"]].task
            save_episode(out, Episode(state, action, images, task, meta.fps), columns)
            if ended.is_set():
                progress(WRITING, k + 1, episodes)
    out.meta.update_chunk_settings(video_files_size_in_mb=meta.video_files_size_in_mb)


def _merge(
    new: Path, part: Path, repo_id: str, meta: LeRobotDatasetMetadata, used: list[int], share: float
) -> list[dict]:
    """Moves a dataset to `part`, with copies of `used` episodes; gives the copies' provenance.

    There are as many as make that share of the frames recorded ones. The features are described as the
    recorded ones': LeRobot merges no others, and those of an older or converted dataset have other entries.
    """
    info = load_info(new)
    lengths = sum(meta.episodes[i]["length"] for i in used)
    copies = round(share / (1 - share) * info.total_frames / lengths)
    shutil.rmtree(part, ignore_errors=True)
    if not copies:
        os.replace(new, part)
        describe_as(part, Path(meta.root))
        return []
    folder, recorded = new.with_name("copies"), Path(meta.root)
    shutil.rmtree(folder, ignore_errors=True)
    with quiet_encoders(), redirect_stderr(StringIO()):  # its own progress bars besides ours
        if left_out := sorted(set(range(meta.total_episodes)) - set(used)):
            whole = LeRobotDataset(meta.repo_id, recorded, video_backend="pyav")
            recorded = Path(delete_episodes(whole, left_out, folder / "used", meta.repo_id).root)
        repeated = _repeated(recorded, meta.repo_id, copies, folder)
        describe_as(new, repeated)
        # One file after the other, as LeRobot would copy what it has merged with every dataset that is added.
        separate = {"concatenate_videos": False, "concatenate_data": False}
        aggregate_datasets([repo_id, meta.repo_id], repo_id, [new, repeated], part, **separate)
    describe_as(part, Path(meta.root))
    return [
        {"episode": k, "method": RECORDED, "source_episode": source}
        for k, source in enumerate(used * copies, info.total_episodes)
    ]


def describe_as(new: Path, recorded: Path) -> None:
    """Gives a dataset another one's description of its features; videos keep their own encoder's."""
    info, like = load_info(new), load_info(recorded).features
    info.features = {k: f if f["dtype"] == "video" else like[k] for k, f in info.features.items()}
    write_info(info, new)


def _repeated(root: Path, repo_id: str, times: int, folder: Path) -> Path:
    """A dataset, in `folder`, of so many copies of one; each is made of two of half as many."""
    if times == 1:
        return root
    parts = [_repeated(root, repo_id, times // 2, folder)] * 2 + [root] * (times % 2)
    aggregate_datasets([repo_id] * len(parts), repo_id, parts, folder / f"{times}")
    return folder / f"{times}"


def summary_of(provenance: list[dict], seconds: dict, scenes: list[Scene], began: float) -> dict:
    """What `augment_guided` returns, of the provenance of every demonstration."""
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


def finish(
    folder: Path, provenance: list[dict], station: Station | None = None, answer_delay: int | None = None
) -> None:
    """Adds provenance (a dict an episode), station, card and delay of the answers to a whole dataset."""
    if answer_delay is not None:
        info = load_info(folder)
        action = info.features[ACTION]
        action["info"] = {**(action.get("info") or {}), ANSWER_DELAY: answer_delay}
        write_info(info, folder)
    write_text(folder / "meta" / PROVENANCE, "".join(json.dumps(line) + "\n" for line in provenance))
    if station:
        station.save(folder / "meta")
    write_card(folder)


def _run(meta: LeRobotDatasetMetadata, setup: AugmentSetup) -> dict:
    """What must be equal for two runs to make the same demonstrations; their number may differ."""
    digest = hashlib.sha256()
    for r in setup.references:
        centres = () if r.centre_mm is None else r.centre_mm
        for x in (r.flange_m, r.area, r.action, centres):
            digest.update(np.ascontiguousarray(x).tobytes())
    c, planner = setup.config, setup.config.method == "planner"
    return {
        "dataset": meta.repo_id,
        "demonstrations": digest.hexdigest(),
        "task": setup.task,
        "twin": c.twin and twin_digest(Twin.load(c.twin)),
        "fidelity": c.fidelity,
        "station": asdict(setup.station or Station()),
        "conditions": c.conditions,
        "method": c.method,
        **({"planner": asdict(c.planner)} if planner else {"start_range_m": setup.start_range_m}),
        **({"start_width": c.start_width} if c.start_width else {}),
        "seed": c.seed,
        "attempts": c.attempts,
        "files": 8,  # version of the work folder's files and of the library
        "candidates": setup.candidates,
        **({"tactile_points": True} if POINTS in setup.further else {}),
        **({"cameras": setup.cameras} if setup.cameras else {}),
        **({"real_share": c.real_share} if c.real_share else {}),
        **({"device": c.device} if c.device != "cpu" else {}),
    }
