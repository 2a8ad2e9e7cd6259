"""Checks, before any work begins, whether a world can be made of a twin; conditions of its episodes."""

from collections.abc import Mapping

import numpy as np

from pneutac_sim.effects import body_effects
from pneutac_sim.errors import InputError, unknown_names
from pneutac_sim.features import CHAMBERS, task_names
from pneutac_sim.finger.online import COMPUTED, PressurePipeline, check_conditions, needed_conditions
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import converged
from pneutac_sim.world.station import MISSING_M, Station
from pneutac_sim.world.tasks import make_task

Conditions = Mapping[str, float | list[float]]
# The flange is held pointing down, so that the straight finger hangs along gravity, a unit vector; nothing
# else hangs at its tip.
USUAL = {"gravity_x": 1.0, "gravity_y": 0.0, "gravity_z": 0.0, "payload_g": 0.0}


def conditions_for(twin: Twin, given: Conditions | None) -> Conditions:
    """All conditions of a world with this twin: those given, else gravity in the base's frame and no payload.

    Raises InputError: a condition is neither a finite number nor a range [low, high] of such, or one that an
    effect of the twin needs is not given.
    """
    given = given or {}
    check_conditions(given)
    known = {*USUAL, *needed_conditions(twin), *(c for e in body_effects().values() for c in e.columns)}
    for fault in unknown_names(given, sorted(known - {*COMPUTED}), "condition"):
        raise InputError(f"conditions: {fault}")
    found = USUAL | dict(given)
    PressurePipeline(twin, draw(found, np.random.default_rng(0)))  # refuses an effect without its conditions
    return found


def draw(conditions: Conditions, rng: np.random.Generator) -> dict[str, float]:
    """A number for each condition, from its range where it has one."""
    return {
        name: float(rng.uniform(*value) if isinstance(value, list | tuple) else value)
        for name, value in conditions.items()
    }


def check_bends(twin: Twin, fidelity: str) -> None:
    """Whether the world has joints for what the twin is of, at this fidelity.

    Raises InputError: it is a gel's, or has several chambers at a fidelity of networks or material points.
    """
    if twin.device not in CHAMBERS:
        raise InputError(
            f"The world needs the twin of a finger or an arm, and this is of '{twin.device}'; give another."
        )
    if CHAMBERS[twin.device] > 1 and fidelity != "probe":
        raise InputError(
            f"Fidelity '{fidelity}' is for fingers of one chamber; this twin's {twin.device} has"
            f" {CHAMBERS[twin.device]}, so give fidelity=probe, in which finger and gel deform by formulas."
        )


def check_networks(twin: Twin, fidelity: str) -> None:
    """Whether the networks that the fidelity asks for belong to the twin, and its finger is stable with them.

    Raises InputError: it has none, they are older than its shape or material, or its soft body alone is
    stiffer than the whole finger, which no controller makes stable; or as `check_bends`.
    """
    check_bends(twin, fidelity)
    if fidelity == "surrogate":  # its modules take a second to start
        from pneutac_sim.surrogate.finger import Networks

        Networks.of(twin).finger(twin)


def check_world(twin: Twin, fidelity: str, conditions: Conditions) -> None:
    """All that can be known of a world before it is made.

    Raises InputError where a condition of an effect is missing or no number, or as `check_networks`.
    """
    check_networks(twin, fidelity)
    conditions_for(twin, conditions)


def out_of_reach(station: Station, length_mm: float) -> dict[str, float]:
    """Tasks whose start the station's arm does not reach, and by how many metres it falls short.

    Raises InputError where the arm cannot carry a finger.
    """
    arm, short = station.make_arm(), {}
    lift_m = station.box_m(length_mm)[0] - station.workspace_low_m
    for name in task_names():
        task, solver = make_task(name), arm.solver()
        for aside in task.starts_m:
            start = np.array(station.home_m or task.home_m + lift_m) + (0.0, aside, 0.0)
            solver.reset()
            converged(solver, start - arm.base_m)
            if solver.missing_m > MISSING_M:
                short[name] = max(short.get(name, 0.0), solver.missing_m)
    return short
