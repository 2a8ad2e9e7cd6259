"""Control steps a second of the environment, by task, fidelity and touch: `python benchmarks/env_speed.py`.

Counted in processor time, so that other load on the machine does not matter, of scripted episodes, which are
in contact for a part of the time; `pneutac benchmark surrogate` measures in contact alone.
"""

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from pneutac_sim.features import FIDELITIES, TASK_NAMES
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.touch import MODES

GOALS = {  # switch, egg, card
    "surrogate": {"image": (600, 540, 400), "area": (700, 680, 450), "none": (1900, 1700, 1200)},
    "probe": {"image": (150,) * 3, "area": (600,) * 3},
}
FULL_STEPS = 5  # of full material points, all in free air: each takes seconds


def steps_per_second(task: str, touch: str, fidelity: str, steps: int) -> float:
    """Median rate over episodes of the scripted expert, whose own time is not counted."""
    env = PneutacEnv(task, touch=touch, fidelity=fidelity)
    if fidelity == "mpm":
        return _first_steps(env)
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


def _first_steps(env: PneutacEnv) -> float:
    env.reset(seed=0)
    expert = ScriptedExpert(env.world, np.random.default_rng(0))
    env.step(expert.action())
    start = time.process_time()
    for _ in range(FULL_STEPS):
        env.step(expert.action())
    return FULL_STEPS / (time.process_time() - start)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=600, help="control steps per cell")
    steps = parser.parse_args().steps
    headings = [f"{m} [steps/s]" for m in MODES]
    table = Table("task", "fidelity", *headings, title="Steps per second of processor time")
    for fidelity in FIDELITIES:
        for task in TASK_NAMES[:1] if fidelity == "mpm" else TASK_NAMES:
            cells = []
            for touch in MODES:
                rate = steps_per_second(task, touch, fidelity, steps)
                goals = GOALS.get(fidelity, {}).get(touch)
                goal = f" (goal {goals[TASK_NAMES.index(task)]})" if goals else ""
                cells.append(f"{rate:.{0 if rate > 10 else 2}f}{goal}")
            table.add_row(task, fidelity, *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
