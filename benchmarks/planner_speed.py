"""Processor time of a control step that the planner tries, in contact: `python benchmarks/planner_speed.py`.

The scripted expert brings the gel into contact; from there the same plan is made again and again, with gel
and finger by formulas (`probe`) and by networks (`surrogate`).
"""

import time

import numpy as np
from rich.console import Console
from rich.table import Table

from pneutac_datasets.demonstrations.augment.planner import CemPlanner, PlannerConfig
from pneutac_sim.features import TASK_NAMES
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.world import World

PLANS, ROUNDS = 8, 5  # the best round counts: other programs only make it slower


def step_ms(task: str, fidelity: str) -> float:
    """Milliseconds for each control step of each sequence that is tried."""
    world = World(task, touch="area", fidelity=fidelity)
    gantry, config = Gantry(world), PlannerConfig()
    world.reset(3)
    expert, action = ScriptedExpert(world, np.random.default_rng(3)), np.zeros(4)
    while world.touch.area < 0.005:
        action = expert.action()
        world.step(action)
    gantry.mirror(world)
    planner = CemPlanner(gantry, config, np.random.default_rng(0))
    goals = np.full(config.horizon, world.touch.area + 0.05), np.tile(world.flange_m, (config.horizon, 1))
    warm = np.tile(action, (config.horizon, 1))
    planner.begin(warm, action, *goals)
    planner.solve()  # compiles
    rounds = []
    for _ in range(ROUNDS):
        start, steps = time.process_time(), gantry.steps
        for _ in range(PLANS):
            planner.begin(warm, action, *goals)
            planner.solve()
        rounds.append((time.process_time() - start) / (gantry.steps - steps))
    return 1e3 * min(rounds)


def main():
    table = Table("task", "formulas [ms]", "networks [ms]", title="A control step that the planner tries")
    for task in TASK_NAMES:
        table.add_row(task, *(f"{step_ms(task, fidelity):.2f}" for fidelity in ("probe", "surrogate")))
    Console().print(table)


if __name__ == "__main__":
    main()
