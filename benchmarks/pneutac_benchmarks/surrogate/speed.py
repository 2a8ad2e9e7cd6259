"""What the networks save, and control steps a second of the environment while its gel presses an object.

Rates of one environment are per second of processor time of one core, so that other load on the machine
matters little; those of a batch are of the clock.
"""

import time
from collections.abc import Callable
from functools import partial

import gymnasium
import numpy as np
import torch

from pneutac_benchmarks.surrogate.options import BenchmarkSurrogateConfig
from pneutac_benchmarks.surrogate.rows import row
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import simulate, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.surrogate.collect import FRAME_S, HOLDS, joint_targets
from pneutac_sim.surrogate.finger import Networks
from pneutac_sim.surrogate.gel_collect import Contact, press, random_contact
from pneutac_sim.twin import Twin
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.world import World

Progress = Callable[[str], None]
CHUNK = 20  # control steps; each chunk is a case
APPROACH = 150  # control steps within which the gel must have found the object
DEPTH_M = 1.0e-3  # to which it presses
FULL_STEPS = 3  # of the environment on material points


def against_full(
    cfg: BenchmarkSurrogateConfig, twin: Twin, networks: Networks, progress: Progress
) -> list[dict]:
    """How many times faster the networks are than what they stand in for, on the same inputs."""
    torch.set_num_threads(1)  # the networks' times and rates are of one core
    progress("finger: full motion against the network")
    solver = devices.finger(twin, particles=cfg.particles, device=cfg.device)
    frames = 3 if cfg.fast else 10
    pressure = np.linspace(6.0, 8.0, frames + 1)
    target = joint_targets(twin, pressure)
    solve_equilibrium(solver, Loads(q_cmd=target[:1]))
    at = FRAME_S * np.arange(frames + 1)

    def loads(t: float) -> Loads:
        return Loads(q_cmd=np.array([np.interp(t, at, q) for q in target.T])[None])

    full = _seconds(
        lambda: simulate(solver, loads, frames * FRAME_S, FRAME_S / HOLDS, damping=60.0, particles=False), 2
    )
    zero = np.zeros(target.shape[1])
    fast = _seconds(
        lambda: networks.action.roll(target[0], zero, target, pressure, frames * FRAME_S), 5, warm=True
    )
    per_s = [s / (frames * FRAME_S) for s in (full, fast)]
    rows = [row("finger's motion, network over full MPM", "times", [full / fast], None, None, "5",
                f"{per_s[0]:.3g} s and {per_s[1]:.2g} s for one of motion")]  # fmt: skip
    progress("gel: full contacts against the network")
    solver, model = devices.gel(twin, device=cfg.device), GelModel.from_twin(twin)
    ratios, times = [], []
    for number in range(1 if cfg.fast else 3):
        contact = random_contact(cfg.seed, number, model.window_mm)
        contact = Contact(contact.press, 0.0).at(0.7 if cfg.fast else 1.4)
        if number == 0:
            press(solver, contact.at(0.1), model)  # compiles
        began = time.perf_counter()
        depth = press(solver, contact, model).depth_mm
        full = time.perf_counter() - began
        fast = _seconds(lambda depth=depth: networks.gel.displacement(depth[-1]), 20, warm=True)
        ratios.append(full / fast)
        times.append((full, fast))
    full, fast = np.mean(times, 0)
    note = f"{full:.3g} s to press to 1.4 mm, in steps of 0.35 mm, and {1e3 * fast:.2g} ms"
    return rows + [row("gel's contact, network over full MPM", "times", ratios, None, None, "3,000", note)]


def environment_rows(cfg: BenchmarkSurrogateConfig, twin: Twin, progress: Progress) -> list[dict]:
    """Control steps a second: by touch, by fidelity, drawn by splats, and in a batch."""
    rows = []
    goals = {"image": "≥ 60", "area": "≥ 400", "none": "≥ 2,000"}
    labels = {"image": "with tactile image", "area": "contact area only", "none": "without touch"}
    for touch, goal in goals.items():
        progress(f"environment {labels[touch]}")
        rates = {f: _rates(World("switch", twin, touch, f), cfg.steps) for f in ("surrogate", "probe")}
        how = "in free air" if touch == "none" else "pressing"
        rows.append(row(f"environment {labels[touch]}", "steps/s", rates["surrogate"],
                        float(rates["probe"].mean()), goal, None, f"one core, {how}"))  # fmt: skip
    progress("environment with the tactile image of splats")
    world = World("switch", twin, "image", "surrogate")
    draw_by_splats(world)
    note = "one core, pressing; 61,360 Gaussians in place of the image plane"
    rows.append(row("environment, tactile image by splats", "steps/s", _rates(world, cfg.steps), None,
                    "≥ 60", None, note))  # fmt: skip
    progress("environment on material points")
    rows.append(_full_row(cfg, twin))
    for touch, goal in goals.items():
        progress(f"{cfg.environments} environments {labels[touch]}")
        rows.append(row(f"batch of {cfg.environments}, {labels[touch]}", "steps/s", _batch(cfg, twin, touch),
                        None, goal, None, "a process each, all together, by the clock"))  # fmt: skip
    return rows


def press_on(world: World) -> np.ndarray:
    """Next action (4,): brings the gel to the lever's bar and keeps it pressed in by about `DEPTH_M`."""
    gel = world.model.site("gel").id
    normal = world.data.site_xmat[gel].reshape(3, 3)[:, 2]
    to = world.data.geom_xpos[world.model.geom("bar").id] - world.gel_m
    if world.touch.pixels:
        # The finger gives way fifty times as much as the gel: a millimetre of the flange is hardly felt.
        along = 40.0 * (DEPTH_M - 1e-3 * float(world.touch.depth_mm.max()))
    else:
        along = 1.5 * float(normal @ to)
    velocity = along * normal + 1.5 * (to - normal * (normal @ to))
    most = max(1.0, float(np.abs(velocity).max()) / 0.08)
    return np.append(velocity / most, 7.0 + np.sin(world.time_s))


def draw_by_splats(world: World) -> None:
    """Lets Gaussians draw the tactile image of a world."""
    from pneutac_sim.splat.gel import SplatSensor

    sensor, splats = world.sensor, SplatSensor(world.sensor.model)
    world.sensor.image = lambda depth: splats.image(sensor.displacement(depth))


def _free(world: World) -> np.ndarray:
    t = world.time_s
    return np.array([0.03 * np.cos(t), 0.03 * np.sin(t), 0.01 * np.cos(2 * t), 7.0 + 5.0 * np.sin(3 * t)])


def _approach(world: World) -> None:
    """Steps a world with touch until its gel presses the bar."""
    world.reset(0)
    pressing = 0
    for _ in range(APPROACH):
        world.step(press_on(world))
        pressing = pressing + 1 if world.touch.pixels else 0
        if pressing == CHUNK:
            return
    raise RuntimeError("the gel has not found the switch")


def _rates(world: World, steps: int) -> np.ndarray:
    """Steps per second of processor time of each chunk; with touch, only of steps in contact."""
    touches = _touches(world)
    action = press_on if touches else _free
    if touches:
        _approach(world)
    else:
        world.reset(0)
        for _ in range(CHUNK):
            world.step(action(world))
    spent = []
    for _ in range(20 * steps):
        now = action(world)
        began = time.process_time()
        world.step(now)
        seconds = time.process_time() - began
        if not touches or world.touch.pixels:
            spent.append(seconds)
        if len(spent) == steps:
            break
    world.close()
    whole = len(spent) // CHUNK * CHUNK
    return 1 / np.array(spent[:whole]).reshape(-1, CHUNK).mean(1)


def _full_row(cfg: BenchmarkSurrogateConfig, twin: Twin) -> dict:
    from pneutac_sim.world.mpm_gel import MpmFinger, MpmGel
    from pneutac_sim.world.touch import Touch

    world = World("switch", twin, "image", "surrogate")  # finds the bar in seconds
    _approach(world)
    world.finger = MpmFinger(twin, cfg.particles, cfg.device)
    world.touch = Touch(world.model, TactileSensor(twin), "image", MpmGel(twin, cfg.device))
    world.touch.sense(world.data)
    spent = []
    for _ in range(1 if cfg.fast else FULL_STEPS):
        now = press_on(world)
        began = time.perf_counter()
        world.step(now)
        spent.append(time.perf_counter() - began)
    world.close()
    return row("environment with tactile image, full MPM", "steps/s", 1 / np.array(spent), None, None, None,
               "pressing, by the clock")  # fmt: skip


class Driven(gymnasium.Wrapper):
    """An environment that finds its own action, so that a batch need not know where each gel is."""

    def reset(self, **kwargs):
        """Starts with the gel on the bar, where there is touch."""
        torch.set_num_threads(1)  # of this process of the batch
        world = self.env.unwrapped.world
        self.env.reset(**kwargs)
        self._action = press_on if _touches(world) else _free
        if _touches(world):
            _approach(world)
        return self.step(None)[0], {}

    def step(self, action):
        """One control step with its own action; the episode never ends."""
        observation, reward, _, _, info = self.env.step(self._action(self.env.unwrapped.world))
        return observation, reward, False, False, info


def _batch(cfg: BenchmarkSurrogateConfig, twin: Twin, touch: str) -> np.ndarray:
    """Steps of all environments together per second, of each chunk."""
    make = partial(_driven, twin, touch)
    batch = gymnasium.vector.AsyncVectorEnv([make] * cfg.environments, context="spawn")
    try:
        batch.reset(seed=0)
        action = np.zeros(batch.action_space.shape, np.float32)
        rates = []
        for k in range(cfg.steps // CHUNK + 1):
            began = time.perf_counter()
            for _ in range(CHUNK):
                batch.step(action)
            if k:  # the first warms up
                rates.append(cfg.environments * CHUNK / (time.perf_counter() - began))
    finally:
        batch.close()
    return np.array(rates)


def _driven(twin: Twin, touch: str) -> Driven:
    return Driven(PneutacEnv("switch", touch, twin))


def _touches(world: World) -> bool:
    return hasattr(world.touch, "depth_mm")


def _seconds(work: Callable, repeats: int, warm: bool = False) -> float:
    """Least seconds of `work()`; with `warm` after a first time that does not count."""
    if warm:
        work()
    found = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return min(found)
