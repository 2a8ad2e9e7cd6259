"""Work folder of an augmentation: each finished piece is one file that appears whole or not at all.

What is there need not be made again, so a run that was killed goes on where it stopped, with any number of
workers, and pieces made twice are equal.

Planned demonstrations carried out once more by the full material points, and how far the two agree.

The same start, object and actions; what differs is how finger and gel deform. The last action goes on for a
second where the task takes longer.
"""

import json
import time
from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from lerobot.utils.constants import ACTION, OBS_STATE

from pneutac_datasets.demonstrations.augment.episode import Attempt, AugmentSetup, Generator
from pneutac_datasets.demonstrations.augment.reference import EXTRA_STEPS, frames_at
from pneutac_datasets.demonstrations.augment.scene import Scene
from pneutac_datasets.demonstrations.faults import TACTILE
from pneutac_datasets.demonstrations.save import Film, decode, encode
from pneutac_sim.errors import InputError
from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.files import whole, write_json
from pneutac_sim.progress import Progress
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import START_SOLVES, Variation, solved_joints
from pneutac_sim.world.world import World

CONTACT = slice(6, 8)  # contact area and log(1 + pixels) in a state of `BatchedWorld`
FEATURE = "feature "  # before the names of a dataset's features


class Work:
    """The folder, next to the output."""

    def __init__(self, folder: Path):
        self.folder = Path(folder)

    def open(self, run: dict) -> None:
        """Begins a run or goes on with the same one; raises InputError where the folder holds another."""
        file, run = self.folder / "run.json", json.loads(json.dumps(run))
        if not file.exists():
            write_json(file, run)
        elif (old := json.loads(file.read_text())) != run:
            changed = ", ".join(k for k in sorted(run.keys() | old.keys()) if run.get(k) != old.get(k))
            raise InputError(
                f"'{self.folder}' holds an unfinished augmentation with another {changed}; delete that"
                " folder, or repeat the command that began it."
            )

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

    def load_spent(self, index: int) -> tuple[dict, dict]:
        """Reads a demonstration's provenance, and the seconds that it took, alone."""
        with np.load(self.episode_file(index)) as d:
            return json.loads(str(d["provenance"])), json.loads(str(d["seconds"]))

    def load_episode(self, index: int) -> tuple[Attempt, dict, dict]:
        """Reads a demonstration, its provenance, and the seconds that it took."""
        columns, films = self.load_columns(index)
        columns |= {key: decode(film) for key, film in films.items()}
        state, action, images = (columns.pop(key) for key in (OBS_STATE, ACTION, TACTILE))
        provenance, seconds = self.load_spent(index)
        scores = provenance.get("cost", 0.0), provenance.get("area_rmse", 1.0)
        with np.load(self.episode_file(index)) as d:
            start = start_from_json(str(d["start"]))
            carried_out = d["carried_out"] if "carried_out" in d.files else None
        return Attempt(state, action, images, None, *scores, start, columns, carried_out), provenance, seconds

    def load_columns(self, index: int) -> tuple[dict[str, np.ndarray], dict[str, Film]]:
        """Reads a demonstration's features (T, ...), and those that are videos."""
        with np.load(self.episode_file(index)) as d:
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
        texts = {"start": start_to_json(attempt.start), "provenance": json.dumps(provenance)}
        texts |= {"seconds": json.dumps(seconds), "statistics": json.dumps(statistics)}
        arrays = {name: np.array(text) for name, text in texts.items()}
        if attempt.carried_out is not None:
            arrays["carried_out"] = attempt.carried_out
        arrays |= {f"{FEATURE}{key}": values for key, values in columns.items()}
        with whole(self.episode_file(index)) as part, part.open("wb") as f:
            np.savez_compressed(f, **arrays)


def start_to_json(start: tuple[int, Variation]) -> str:
    """The seed and variation with which a demonstration begins, as text."""
    return json.dumps({"seed": start[0], **asdict(start[1])})


def start_from_json(text: str) -> tuple[int, Variation]:
    """Seed and variation from the text of `start_to_json`."""
    values = json.loads(text)
    seed = values.pop("seed")
    return seed, Variation(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})


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


class Sensed(NamedTuple):
    """An attempt of T frames in a batch of worlds, which have neither the arm's joints nor images."""

    start: tuple[int, Variation]  # seed and variation
    states: np.ndarray  # (T, 8 + C) as `BatchedWorld.state`
    actions: np.ndarray  # (T, 3 + C) float32
    displacement_mm: dict[
        int, np.ndarray
    ]  # (80, 59) of the gel's face, of the frames in which it was touched


def save_sensed(setup: AugmentSetup, folder: Path, index: int, sensed: Sensed, provenance: dict) -> None:
    """Adds joints and images to an accepted attempt, and saves it as the demonstration of an index."""
    began, world = time.process_time(), generator(setup, folder).world
    solver, states = world.arm.solver(), sensed.states
    flange_m = states[:, :3] - world.arm.base_m
    for _ in range(START_SOLVES):
        solver.solve(flange_m[0])
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
    return _made[1]


def _spent(g: Generator) -> dict:
    return {**g.gantry.seconds, **g.seconds, "planner_steps": g.gantry.steps}


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
            world = checking_world(setup)
            began = time.monotonic()
        write_json(work.check_file(k), asdict(agreement(world, k, attempt, step)))


def checking_world(setup: AugmentSetup, fidelity: str = "mpm") -> World:
    """The world in which demonstrations are carried out once more."""
    twin = Twin.load(setup.twin) if setup.twin else None
    world = World(setup.task, twin, "image", fidelity, setup.conditions, station=setup.where)
    world.widen_starts(setup.start_width)
    return world


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
