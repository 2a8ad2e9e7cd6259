"""`pneutac benchmark worlds`: control steps a second of many worlds, and of single worlds on all cores."""

import multiprocessing
import os
import platform
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError, check_between, check_choice
from pneutac_sim.features import TASK_NAMES
from pneutac_sim.twin import Twin
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.world import World


@dataclass
class BenchmarkWorldsConfig:
    """Options of `pneutac benchmark worlds`.

    Attributes:
        device: of the batch, `cuda` or `cpu`.
        tasks: of `switch`, `egg` and `card`.
        worlds: sizes of the batch.
        steps: control steps that are timed.
        images: whether tactile images are drawn as well, in a row of their own.
        processes: single worlds that run at once; 0 for one on each core, -1 for none.
        out: folder for `result.json`.
    """

    device: str = "cuda"
    tasks: list[str] = field(default_factory=lambda: list(TASK_NAMES))
    worlds: list[int] = field(default_factory=lambda: [64, 512, 4096])
    steps: int = 40
    images: bool = True
    processes: int = 0
    out: Path | None = None

    def __post_init__(self):
        check_between(1, 100_000, steps=self.steps, **{f"worlds[{i}]": n for i, n in enumerate(self.worlds)})
        check_between(-1, 1024, processes=self.processes)
        check_choice("device", self.device, ("cpu", "cuda"))
        if not self.worlds:
            raise InputError("worlds is empty; give numbers of worlds, such as 64,1024.")
        unknown = [t for t in self.tasks if t not in TASK_NAMES]
        if unknown:
            raise InputError(f"tasks names {', '.join(unknown)}; there are {', '.join(TASK_NAMES)}.")


def actions_of(task: str, episodes: int = 8, steps: int = 90) -> np.ndarray:
    """Actions (episodes, steps, 4) of the scripted expert in the single world, seeds 0 on."""
    world = Gantry(World(task, Twin.builtin(), "area", "surrogate"))
    out = np.empty((episodes, steps, 3 + world.chambers), np.float32)
    for seed in range(episodes):
        world.reset(seed)
        expert = ScriptedExpert(world, np.random.default_rng(seed))
        for t in range(steps):
            out[seed, t] = expert.action()
            world.step(out[seed, t])
    return out


def batch_rate(task: str, worlds: int, device: str, steps: int, images: bool, actions: np.ndarray) -> dict:
    """Rates and shares of one batch, in the part of the expert's episodes that touches.

    World i does what the expert does in episode i mod 8, each from its own start of those 8.
    """
    import torch

    from pneutac_sim.world.batch import BatchedWorld

    batch = BatchedWorld(task, worlds, device=device)
    wait = torch.cuda.synchronize if device == "cuda" else lambda: None
    batch.reset(np.arange(worlds) % len(actions))
    sent = torch.tensor(actions, device=device)[torch.arange(worlds, device=device) % len(actions)]
    began, touched, drawn_s, physics_s = None, [], 0.0, 0.0
    first = sent.shape[1] - steps
    for t in range(sent.shape[1]):
        if t == first:
            wait()
            began = time.perf_counter()
        batch.step(sent[:, t])
        if t >= first:
            touched.append(batch.area.count_nonzero())
    wait()
    seconds = time.perf_counter() - began
    touched = float(torch.stack(touched).float().mean()) / worlds
    repeats = max(1, steps // 4)
    state = {k: v.clone() for k, v in batch._everything().items()}
    wait()
    began = time.perf_counter()
    for _ in range(repeats):
        batch.repeat_physics()
    wait()
    physics_s = (time.perf_counter() - began) / repeats
    for name, tensor in batch._everything().items():
        tensor.copy_(state[name])
    rate = {
        "task": task,
        "worlds": worlds,
        "steps_per_s": worlds * steps / seconds,
        "ms_a_step": 1e3 * seconds / steps,
        "share_not_mujoco": 1 - physics_s * steps / seconds,
        "in_contact": touched,
    }
    if images:
        batch.images()
        wait()
        began = time.perf_counter()
        for _ in range(repeats):
            batch.images()
        wait()
        drawn_s = (time.perf_counter() - began) / repeats
        rate["images_per_s"] = worlds / (drawn_s + seconds / steps)
    return rate


_ready = None  # of a process: a world that is compiled, and the barrier before the clocks run


def _begin(task: str, barrier) -> None:
    global _ready
    world = Gantry(World(task, Twin.builtin(), "area", "surrogate"))
    _ready = world, barrier


def _single(actions: np.ndarray, steps: int) -> float:
    """Control steps a second of one world on one core, over the same part of the episodes."""
    world, barrier = _ready
    for action in actions[0]:
        world.step(action)  # compiles
    spent, count = 0.0, 0
    barrier.wait()  # all cores are busy at once
    for seed, episode in enumerate(actions):
        world.reset(seed)
        for t, action in enumerate(episode):
            began = time.perf_counter()
            world.step(action)
            if t >= len(episode) - steps:
                spent, count = spent + time.perf_counter() - began, count + 1
    return count / spent


def single_rate(task: str, actions: np.ndarray, steps: int, processes: int) -> float:
    """Control steps a second of as many single worlds at once as there are processes."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(processes, _begin, (task, context.Barrier(processes))) as pool:
        return sum(pool.starmap(_single, [(actions, steps)] * processes, chunksize=1))


def device_name(device: str) -> str:
    """What the batch runs on."""
    if device == "cpu":
        return f"{platform.processor() or 'CPU'}, {os.cpu_count()} cores"
    import torch

    return torch.cuda.get_device_name()


def benchmark_worlds(config: BenchmarkWorldsConfig) -> None:
    """Times batches and single worlds; prints and writes a table."""
    from rich.console import Console
    from rich.markdown import Markdown

    from lerobot_pneutac.reports.page import write_result
    from pneutac_benchmarks.tables import markdown

    processes = config.processes or len(os.sched_getaffinity(0))
    rows = []
    for task in config.tasks:
        actions = actions_of(task)
        for worlds in config.worlds:
            rows.append(batch_rate(task, worlds, config.device, config.steps, config.images, actions))
        if processes > 0:
            rate = single_rate(task, actions, config.steps, processes)
            rows.append({"task": task, "worlds": processes, "steps_per_s": rate, "single": True})
    device = device_name(config.device)
    text = markdown(
        (
            "task",
            "worlds",
            "control steps/s",
            "ms a step",
            "not MuJoCo Warp",
            "in contact",
            "with images, images/s",
        ),
        [
            (
                r["task"],
                f"{r['worlds']} single, one a core" if r.get("single") else str(r["worlds"]),
                f"{r['steps_per_s']:,.0f}",
                *(
                    f"{r[k]:{f}}" if k in r else ""
                    for k, f in (("ms_a_step", ".1f"), ("share_not_mujoco", ".0%"))
                ),
                *(
                    f"{r[k]:{f}}" if k in r else ""
                    for k, f in (("in_contact", ".0%"), ("images_per_s", ",.0f"))
                ),
            )
            for r in rows
        ],
    )
    Console().print(Markdown("\n".join([f"Batch on {device}.", "", *text])))
    if config.out:
        write_result(config.out, {"device": device, "rows": rows})
