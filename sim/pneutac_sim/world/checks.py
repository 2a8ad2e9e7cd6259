"""Whether a world can be made of a twin, asked before any work begins."""

import numpy as np

from pneutac_sim.features import task_names
from pneutac_sim.twin import Twin
from pneutac_sim.world.conditions import Conditions, conditions_for
from pneutac_sim.world.station import MISSING_M, Station
from pneutac_sim.world.tasks import make_task


def check_networks(twin: Twin, fidelity: str) -> None:
    """Whether the networks that the fidelity asks for belong to the twin, and its finger is stable with them.

    Raises:
        InputError: it has none, they are older than its shape or material, or its soft body alone is stiffer
            than the whole finger, which no controller makes stable.
    """
    if fidelity == "surrogate":  # its modules take a second to start
        from pneutac_sim.surrogate.networks import Networks

        Networks.of(twin).finger(twin)


def check_world(twin: Twin, fidelity: str, conditions: Conditions) -> None:
    """All that can be known of a world before it is made.

    Raises:
        InputError: a condition of an effect is missing or no number, or as `check_networks`.
    """
    conditions_for(twin, conditions)
    check_networks(twin, fidelity)


def out_of_reach(station: Station, length_mm: float) -> dict[str, float]:
    """Tasks whose start the station's arm does not reach, and by how many metres it falls short.

    Args:
        station: with its arm.
        length_mm: of the finger.

    Raises:
        InputError: the arm cannot carry a finger.
    """
    arm, short = station.make_arm(), {}
    lift_m = station.box_m(length_mm)[0] - station.workspace_low_m
    for name in task_names():
        task, solver = make_task(name), arm.solver()
        for aside in task.starts_m:
            start = np.array(station.home_m or task.home_m + lift_m) + (0.0, aside, 0.0)
            solver.reset()
            for _ in range(20):
                solver.solve(start - arm.base_m)
            if solver.missing_m > MISSING_M:
                short[name] = max(short.get(name, 0.0), solver.missing_m)
    return short
