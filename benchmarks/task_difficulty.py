"""How much the tasks need touch: `python benchmarks/task_difficulty.py --episodes=60`.

Compares the scripted expert with the blind replay of its demonstrations: the actions of a successful episode,
played back open loop on other random starts. Who replays knows how, but not where. The policy's
observation tells where only by touch, so a task on which the replay succeeds needs none.
"""

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from lerobot_robot_pneutac.standin.world import StandinWorld
from pneutac_sim.features import CONTROL_HZ, TRIAL_S, task_names
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.world import World

STEPS = TRIAL_S * CONTROL_HZ
EXPERT_GOAL, REPLAY_GOAL = 0.95, 0.40


def succeeded(world: World) -> bool:
    """Whether the trial has ended well."""
    return world.success and not world.failure


def demonstrate(world: World, seed: int) -> np.ndarray:
    """Actions (T, 4) of the expert on start `seed`, until the trial ends."""
    world.reset(seed)
    expert = ScriptedExpert(world, np.random.default_rng(seed))
    actions = []
    while not (world.success or world.failure) and len(actions) < STEPS:
        actions.append(expert.action())
        world.step(actions[-1])
    return np.array(actions)


def replay(world: World, actions: np.ndarray, seed: int) -> bool:
    """Plays `actions` (T, 4) on start `seed`, then holds still for 2 s; whether it succeeded."""
    world.reset(seed)
    for i in range(min(STEPS, len(actions) + 2 * CONTROL_HZ)):
        world.step(actions[i] if i < len(actions) else [0.0, 0.0, 0.0, actions[-1, 3]])
        if world.success or world.failure:
            break
    return succeeded(world)


def measure(task: str, episodes: int, standin: bool = False) -> tuple[int, int, np.ndarray]:
    """Successes of expert and blind replay out of `episodes`, and the demonstrations' lengths (n,), s.

    Replay k takes the demonstration k of the successful ones, in turn, on a start that no expert has seen.
    """
    world = StandinWorld(task, touch="none") if standin else World(task, touch="none")
    demonstrations = []
    for seed in range(episodes):
        actions = demonstrate(world, seed)
        if succeeded(world):
            demonstrations.append(actions)
    if not demonstrations:
        return 0, 0, np.full(1, np.nan)
    turns = (demonstrations[k % len(demonstrations)] for k in range(episodes))
    replayed = sum(replay(world, actions, 10_000 + k) for k, actions in enumerate(turns))
    return len(demonstrations), replayed, np.array([len(a) for a in demonstrations]) / CONTROL_HZ


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=60, help="trials of each kind and task")
    parser.add_argument("--standin", action="store_true", help="on the stand-in for reality")
    options = parser.parse_args()
    n = options.episodes
    if n < 1:
        parser.error(f"--episodes is {n}; it must be at least 1.")
    table = Table(
        "task",
        f"expert (goal {EXPERT_GOAL:.0%} or more)",
        f"blind replay (goal {REPLAY_GOAL:.0%} or less)",
        "length, median and longest [s]",
        title=f"Success in {n} random starts",
    )
    for task in task_names():
        expert, blind, seconds = measure(task, n, options.standin)
        table.add_row(
            task,
            f"{expert}/{n} = {expert / n:.0%}",
            f"{blind}/{n} = {blind / n:.0%}",
            f"{np.median(seconds):.1f}, {seconds.max():.1f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
