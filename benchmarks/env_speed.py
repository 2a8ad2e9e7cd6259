"""Control steps a second of the environment, by task and touch: `python benchmarks/env_speed.py`.

Counted in processor time of one core, so that other load on the machine does not matter.
"""

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from pneutac_sim.features import TASK_NAMES
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.touch import MODES

GOALS = {"image": 150, "area": 600, "none": None}  # steps/s on one core


def steps_per_second(task: str, touch: str, steps: int) -> float:
    """Median rate over episodes of the scripted expert, whose own time is not counted."""
    env = PneutacEnv(task, touch=touch)
    rates, seed = [], 0
    while seed == 0 or sum(n for n, _ in rates) < steps:
        env.reset(seed=seed)
        expert = ScriptedExpert(env.world, np.random.default_rng(seed))
        n, spent, ended = 0, 0.0, False
        while not ended and n < 150:
            action = expert.action()
            start = time.process_time()
            _, _, ended, _, _ = env.step(action)
            spent += time.process_time() - start
            n += 1
        if seed:  # the first episode compiles and warms up
            rates.append((n, n / spent))
        seed += 1
    return float(np.median([rate for _, rate in rates]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=600, help="control steps per cell")
    steps = parser.parse_args().steps
    table = Table("task", *[f"{m} [steps/s]" for m in MODES], title="Steps per second of one core")
    for task in TASK_NAMES:
        cells = []
        for touch in MODES:
            rate, goal = steps_per_second(task, touch, steps), GOALS[touch]
            cells.append(f"{rate:.0f}" + (f" (goal {goal})" if goal else ""))
        table.add_row(task, *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
