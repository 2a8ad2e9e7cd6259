"""What each unit of the policy benchmark does; every function writes below its folder and returns numbers."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from pneutac_benchmarks.policy.frames import Frames
from pneutac_benchmarks.policy.plan import RESULT
from pneutac_datasets.demonstrations.augment.episode import AugmentSetup, Generator
from pneutac_datasets.demonstrations.augment.library import lagged_answers
from pneutac_datasets.demonstrations.augment.options import AugmentConfig, DatasetRef
from pneutac_datasets.demonstrations.augment.scene import Scene
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_sim.errors import InputError
from pneutac_sim.features import CONTROL_HZ, TRIAL_S, Places
from pneutac_sim.gel.contact import SPECKS
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

HELD_OUT = 0.1  # share of the final data set's episodes, where the weights are chosen by them
ATTEMPTS = 60  # variants tried for one demonstration
FRAMES_FILE, SCENES_FILE = "frames.npz", "scenes.json"
FILM_SIZE = 320, 240
PPO_ENVS = 8
STEPS = TRIAL_S * CONTROL_HZ
STARTS_EACH = 500  # starts that a recording may try
LET_GO_S = 1.0  # without touch at the end of a trial, that is, the touch was lost


def record(folder: Path, options: dict, needs: list[Path]) -> dict:
    """Demonstrations of a modelled person on the stand-in."""
    episodes, tried, of_tries = _recorded(options)
    Frames.of(episodes, _sensor(options["twin"])).save(folder / FRAMES_FILE)
    return {"episodes": len(episodes), "frames": sum(map(len, episodes)), "tried": tried, "tries": of_tries}


def _recorded(options: dict) -> tuple[list[Episode], int, list[str]]:
    """The first successful ones, how many were tried, and why the others failed."""
    from pneutac_sim.world.expert import demonstrator

    world = _standin(options["task"], options["twin"], options["start_width"])
    episodes, reasons = [], []
    for k in range(STARTS_EACH):
        start = options["seed"] * STARTS_EACH + k
        observation = world.reset(start)
        person = demonstrator(world, np.random.default_rng([start, 1]), options["person"])
        states, actions, images = [], [], []
        while len(states) < STEPS and not (world.success or world.failure):
            states.append(observation.state)
            actions.append(person.action())
            images.append(observation.tactile)
            observation = world.step(actions[-1])
        area = np.array(states)[:, Places.of(1).area]
        if world.success and not world.failure and (area >= SPECKS).any() and not area[0] >= SPECKS:
            made = np.array(states), np.array(actions), np.array(images)
            episodes.append(Episode(*made, world.task.description, CONTROL_HZ))
        else:
            reasons.append(_why(world, area))
        if len(episodes) == options["episodes"]:
            return episodes, k + 1, reasons
    raise InputError(
        f"{len(episodes)} of {STARTS_EACH} demonstrations of '{options['task']}' succeeded; give a lower"
        " --person or --start_width."
    )


def _why(world, area: np.ndarray) -> str:
    """Why a trial has failed: by its task, or by how its time ran out."""
    if world.failure:
        return world.failure
    if world.success:
        return "done without touch, or in touch from the beginning"
    touched = np.flatnonzero(area >= SPECKS)
    if not len(touched):
        return "time-out, never touched"
    lost = len(area) - 1 - touched[-1] > LET_GO_S * CONTROL_HZ
    return "time-out, touch lost" if lost else "time-out, in touch"


def scenes(folder: Path, options: dict, needs: list[Path]) -> dict:
    """Where the objects stood, for the planner."""
    generator = _generator(options, needs[0])
    found = [asdict(generator.scene(k)) for k in range(options["episodes"])]
    (folder / SCENES_FILE).write_text(json.dumps(found))
    return {"scenes": found}


def augment(folder: Path, options: dict, needs: list[Path]) -> dict:
    """New demonstrations, carried out on the twin."""
    generator, places = _generator(options, needs[0]), []
    if len(needs) > 1:
        found = json.loads((needs[1] / SCENES_FILE).read_text())
        places = [Scene(**d | {"shift_m": tuple(d["shift_m"])}) for d in found]
    made, rejected = [], []
    words = generator.world.task.description
    for k in range(options["first"], options["first"] + options["episodes"]):
        attempt, provenance = generator.episode(k, places)
        made.append(Episode(attempt.state, attempt.action, attempt.images, words, CONTROL_HZ))
        rejected += [r["reason"] for r in provenance["rejected"]]
    Frames.of(made).save(folder / FRAMES_FILE)
    counts = {reason: rejected.count(reason) for reason in sorted(set(rejected))}
    return {"episodes": len(made), "frames": sum(map(len, made)), "rejected": counts}


def _generator(options: dict, recording: Path) -> Generator:
    references = Frames.load(recording / FRAMES_FILE).references(np.array(Station().base_m))
    guided = {} if options["method"] == "planner" else {"start_width": options["start_width"]}
    config = AugmentConfig(
        dataset=DatasetRef("", recording),
        output=DatasetRef("", recording),
        twin=_path(options["twin"]),
        attempts=ATTEMPTS,
        **{name: options[name] for name in ("fidelity", "seed", "method")},
        **guided,
    )
    return Generator(AugmentSetup(config, references, options["task"]))


def naive(folder: Path, options: dict, needs: list[Path]) -> dict:
    """New demonstrations, varied without a simulator."""
    from pneutac_datasets.demonstrations.naive import varied

    real = Frames.load(needs[0] / FRAMES_FILE)

    class Pooled(Episode):
        pixels = int(real.shape[1] * real.shape[2])  # of the whole image

    def load(k: int) -> Episode:
        rows = real.episode == k
        return Pooled(real.state[rows].astype(float), real.action[rows], real.images[rows], "", CONTROL_HZ)

    seeded = options["episodes"], options["seed"]
    made = Frames.of(list(varied(load, real.episodes, real.state, real.action, *seeded)))
    replace(made, shape=real.shape).save(folder / FRAMES_FILE)
    return {"episodes": made.episodes, "frames": len(made)}


def ppo(folder: Path, options: dict, needs: list[Path]) -> dict:
    """An actor, trained on the twin by formulas; goes on where it was stopped."""
    from lerobot_pneutac.rl.ppo import Compute, train_ppo

    card = train_ppo(
        options["task"],
        _twin(options["twin"]),
        options["seed"],
        options["steps"],
        folder / "actor",
        Compute(PPO_ENVS, tries=options["tries"]),
    )
    return {"actor": str(folder / "actor")} | {k: card[k] for k in ("steps", "steps_per_s", "test")}


def student(folder: Path, options: dict, needs: list[Path]) -> dict:
    """Successful demonstrations of that actor."""
    from lerobot_pneutac.rl.options import StudentRef
    from lerobot_pneutac.rl.student import rolled_out

    o = options
    world = World(o["task"], _twin(o["twin"]), "image", o["fidelity"])
    wanted = StudentRef(episodes=o["episodes"], fidelity=o["fidelity"])
    tried = list(rolled_out(needs[0] / "actor", world, o["seed"], wanted))
    made = [episode for episode in tried if episode is not None]
    Frames.of(made).save(folder / FRAMES_FILE)
    return {"episodes": len(made), "frames": sum(map(len, made)), "trials": len(tried)}


def train(folder: Path, options: dict, needs: list[Path]) -> dict:
    """A policy of what was made and of what is real: at once, or one after the other."""
    from pneutac_benchmarks.policy.in_memory import held_out_episodes, new_policy, save
    from pneutac_benchmarks.policy.in_memory import train as learn

    o, seed = options, options["seed"]
    if o["device"] == "cuda":
        torch.cuda.set_device(os.getpid() % torch.cuda.device_count())  # units side by side share all GPUs
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)
    parts = [Frames.load(need / FRAMES_FILE) for need in needs]
    real = Frames.joined(parts[len(parts) - o["real"] :]).first_episodes(o["episodes"]) if o["real"] else None
    made = Frames.joined(parts[: len(parts) - o["real"]]) if len(parts) > o["real"] else None
    if o["memory"]:
        known = real.first_episodes(min(o["episodes"], real.episodes))
        delay = lagged_answers(known.references(np.array(Station().base_m)))[1]
        made, real = (f and f.answered_early(delay) for f in (made, real))
    every = Frames.joined([x for x in (made, real) if x is not None])
    network = {k: o[k] for k in ("use_tactile", "memory", "huber_delta", "networks")}
    policy = new_policy(lr=o["lr"], seed=seed, device=o["device"], scaling=every.scaling, **network)
    result, updates, copies, last = {}, o["pretrain_updates"] + o["finetune_updates"], (), every
    if made and real and o["then"]:
        result["pretraining"] = asdict(learn(policy, made, o["pretrain_updates"], o["batch"], seed))
        policy.config.optimizer_lr = o["finetune_lr"]
        updates, last = o["finetune_updates"], real
    elif made and real:
        times = round(o["real_share"] / (1 - o["real_share"]) * len(made) / len(real))
        copies = [1] * made.episodes + [max(times, 1)] * real.episodes
    away = held_out_episodes(last.episodes, HELD_OUT, seed) if o["select"] == "held_out" else []
    done = learn(policy, last, updates, o["batch"], seed + 1, away, copies)
    path = save(policy, done, folder)
    return result | {"training": asdict(done), "held_out_episodes": away, "checkpoint": str(path)}


def evaluate(folder: Path, options: dict, needs: list[Path]) -> dict:
    """Trials on the stand-in, on the CPU: start, whether the task was done, after how many steps, why not."""
    policy, world = _trained(needs[0]), _standin(options["task"], options["twin"], options["start_width"])
    starts = range(options["start"], options["start"] + options["trials"])
    trials = [_tried(policy, world, start) for start in starts]
    return {"success_percent": 100 * float(np.mean([t["success"] for t in trials])), "trials": trials}


def film(folder: Path, options: dict, needs: list[Path]) -> dict:
    """Films of the first failed trials, which are done once more; a trial depends on its start alone."""
    from lerobot.utils.io_utils import write_video

    policy, world = _trained(needs[0]), _standin(options["task"], options["twin"], options["start_width"])
    trials = [t for need in needs[1:] for t in json.loads((need / RESULT).read_text())["result"]["trials"]]
    films = []
    for trial in [t for t in trials if not t["success"]][: options["episodes"]]:
        pictures, path = [], folder / f"start_{trial['start']}.mp4"
        _tried(policy, world, trial["start"], lambda: pictures.append(world.render(*FILM_SIZE)))  # noqa: B023
        write_video(path, pictures, CONTROL_HZ)
        films.append({"start": trial["start"], "reason": trial["reason"], "file": str(path)})
    return {"films": films}


def _tried(policy, world, start: int, seen: Callable[[], None] = lambda: None) -> dict:
    """One trial; `seen` is called before each step."""
    observation, areas = world.reset(start), []
    policy.reset()
    while len(areas) < STEPS and not (world.success or world.failure):
        seen()
        observation = world.step(_action(policy, observation))
        areas.append(observation.state[Places.of(1).area])
    done = bool(world.success and not world.failure)
    why = "" if done else _why(world, np.array(areas))
    return {"start": start, "success": done, "steps": len(areas), "reason": why}


def _trained(folder: Path):
    (path,) = (folder / "checkpoints").glob("*/pretrained_model")
    return _policy(path)


def _action(policy, observation) -> np.ndarray:
    from lerobot.utils.constants import OBS_STATE

    from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE

    image = torch.from_numpy(observation.tactile).permute(2, 0, 1)[None].float() / 255
    seen = {OBS_STATE: torch.from_numpy(observation.state)[None], TACTILE: image}
    return policy.select_action(seen)[0].numpy()


@lru_cache(maxsize=1)
def _policy(path: Path):
    from lerobot.configs import PreTrainedConfig

    from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy

    config = PreTrainedConfig.from_pretrained(path)
    config.device = "cpu"
    return PneutacBCPolicy.from_pretrained(path, config=config)


@lru_cache(maxsize=3)
def _standin(task: str, twin: str | None, start_width: float):
    from lerobot_robot_pneutac.options import standin_sensor
    from lerobot_robot_pneutac.standin.world import StandinWorld

    world = StandinWorld(task, **standin_sensor(_path(twin)))
    world.widen_starts(start_width)
    return world


@lru_cache(maxsize=2)
def _sensor(twin: str | None) -> TactileSensor:
    return TactileSensor(_twin(twin) or Twin.builtin())


def _path(twin: str | None) -> Path | None:
    return Path(twin) if twin else None


def _twin(twin: str | None) -> Twin | None:
    return Twin.load(twin) if twin else None


KINDS = {f.__name__: f for f in (record, scenes, augment, naive, ppo, student, train, evaluate, film)}
