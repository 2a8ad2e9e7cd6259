"""What each unit of the policy benchmark does; every function writes below its folder and returns numbers."""

import os
import shutil
from dataclasses import asdict
from pathlib import Path

import torch

from pneutac_sim.features import CONTROL_HZ, TRIAL_S
from pneutac_sim.twin import Twin

HELD_OUT = 0.1  # share of the final data set's episodes, where the weights are chosen by them
ATTEMPTS = 60  # variants tried for one demonstration
FRAMES_FILE = "frames.npz"
PPO_ENVS = 8


def repo_id(folder: Path) -> str:
    """Name of the dataset in a unit's folder `task/seed/what`."""
    return "local/" + "_".join(folder.parts[-3:])


def record(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """Scripted demonstrations on the stand-in."""
    from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
    from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
    from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
    from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
    from pneutac_datasets.demonstrations.record import record_episodes

    task, seed, root = options["task"], options["seed"], folder / "dataset"
    shutil.rmtree(root, ignore_errors=True)
    twin = _folder(options)
    robot = PneutacSim(
        PneutacSimConfig(id="standin", task=task, seed=seed, standin=True, twin=twin, calibration_dir=folder)
    )
    teleop = PneutacScripted(
        PneutacScriptedConfig(
            id="scripted", seed=seed, episode_steps=TRIAL_S * CONTROL_HZ, calibration_dir=folder
        )
    )
    robot.connect()
    try:
        words = robot.world.task.description
        record_episodes(robot, teleop, repo_id(folder), root, options["episodes"], words, True)
    finally:
        robot.disconnect()
    return {"dataset": str(root), "episodes": options["episodes"], "tried": len(robot.successes)}


def augment(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """New demonstrations, planned on the twin and guided by touch."""
    return _augment("tactile", folder, options, needs, workers)


def naive(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """New demonstrations, varied without a simulator."""
    return _augment("naive", folder, options, needs, workers)


def _augment(method: str, folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef
    from lerobot_pneutac.verbs.augment import augment as augment_dataset

    root = folder / "dataset"
    if root.exists() and not root.with_name("dataset.work").exists():
        shutil.rmtree(root)  # whole, but stopped before its numbers were kept
    cfg = AugmentConfig(
        dataset=DatasetRef(repo_id(needs[0]), needs[0] / "dataset"),
        output=DatasetRef(repo_id(folder), root),
        method=method,
        workers=workers,
        attempts=ATTEMPTS,
        **options,
    )
    summary = augment_dataset(cfg).summary
    return {"dataset": str(root)} | {k: summary[k] for k in ("kept", "attempts", "rejected", "wall_s")}


def ppo(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """An actor, trained on the twin by formulas; goes on where it was stopped."""
    from lerobot_pneutac.rl.ppo import Compute, train_ppo

    card = train_ppo(
        options["task"],
        _twin(options),
        options["seed"],
        options["steps"],
        folder / "actor",
        Compute(PPO_ENVS, tries=options["tries"]),
    )
    return {"actor": str(folder / "actor")} | {k: card[k] for k in ("steps", "steps_per_s", "test")}


def student(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """Successful demonstrations of that actor."""
    from lerobot_pneutac.rl.options import StudentRef
    from lerobot_pneutac.rl.student import record_student

    root = folder / "dataset"
    shutil.rmtree(root, ignore_errors=True)
    o = options
    wanted = StudentRef(repo_id(folder), root, o["episodes"], o["fidelity"], video=True)
    done = record_student(needs[0] / "actor", o["task"], _twin(o), o["seed"], wanted)
    return {"dataset": str(root), "episodes": done.episodes, "trials": done.trials}


def frames(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """Datasets as arrays, for `train`."""
    from pneutac_benchmarks.policy.frames import read_frames

    read = read_frames(*((need / "dataset", repo_id(need)) for need in needs))
    folder.mkdir(parents=True, exist_ok=True)
    read.save(folder / FRAMES_FILE)
    return {"episodes": read.demonstrations.episodes, "frames": read.demonstrations.frames}


def train(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """A policy; with two needs it is trained on the first and then on the second."""
    from pneutac_benchmarks.policy.frames import Frames
    from pneutac_benchmarks.policy.in_memory import held_out_episodes, new_policy, save
    from pneutac_benchmarks.policy.in_memory import train as learn

    o, seed = options, options["seed"]
    if o["device"] == "cuda":
        torch.cuda.set_device(os.getpid() % torch.cuda.device_count())  # units side by side share all GPUs
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)
    policy = new_policy(o["use_tactile"], o["lr"], seed, o["device"])
    loaded = [Frames.load(need / FRAMES_FILE, o["use_tactile"]) for need in needs]
    result, updates = {}, o["pretrain_updates"] + o["finetune_updates"]
    if len(needs) == 2:
        first = learn(policy, loaded[0], o["pretrain_updates"], o["batch"], seed)
        result["pretraining"] = asdict(first)
        policy.config.optimizer_lr = o["finetune_lr"]
        updates = o["finetune_updates"]
    away = []
    if o["select"] == "held_out":
        away = held_out_episodes(loaded[-1].demonstrations.episodes, HELD_OUT, seed)
    last = learn(policy, loaded[-1], updates, o["batch"], seed + 1, away)
    path = save(policy, last, folder)
    return result | {"training": asdict(last), "held_out_episodes": away, "checkpoint": str(path)}


def evaluate(folder: Path, options: dict, needs: list[Path], workers: int) -> dict:
    """Trials on the stand-in by LeRobot's own evaluation, on the CPU and without videos."""
    from lerobot.configs import PreTrainedConfig
    from lerobot.envs.factory import make_env, make_env_pre_post_processors
    from lerobot.policies import make_pre_post_processors
    from lerobot.scripts.lerobot_eval import eval_policy

    from lerobot_robot_pneutac.env import PneutacStandinConfig
    from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy

    (path,) = (needs[0] / "checkpoints").glob("*/pretrained_model")
    config = PreTrainedConfig.from_pretrained(path)
    config.device = "cpu"
    policy = PneutacBCPolicy.from_pretrained(path, config=config)
    on_cpu = {"device_processor": {"device": "cpu"}}
    before, after = make_pre_post_processors(policy.config, str(path), preprocessor_overrides=on_cpu)
    world = PneutacStandinConfig(task=options["task"], twin=_folder(options))
    env_before, env_after = make_env_pre_post_processors(env_cfg=world, policy_cfg=policy.config)
    env = make_env(world, n_envs=1)[world.type][0]
    try:
        info = eval_policy(
            env,
            policy,
            env_before,
            env_after,
            before,
            after,
            n_episodes=options["trials"],
            start_seed=options["start"],
        )
    finally:
        env.close()
    trials = [{"start": t["seed"], "success": bool(t["success"])} for t in info["per_episode"]]
    return {"success_percent": info["aggregated"]["pc_success"], "trials": trials}


def _folder(options: dict) -> Path | None:
    return Path(options["twin"]) if options["twin"] else None


def _twin(options: dict) -> Twin | None:
    return Twin.load(options["twin"]) if options["twin"] else None


KINDS = {f.__name__: f for f in (record, augment, naive, ppo, student, frames, train, evaluate)}
