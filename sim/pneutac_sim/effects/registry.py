"""Finds effects: the library's own, and those that other packages add through an entry point.

Order within a stage (it matters: a leak is slowed by the lag behind it):

- pneumatics: dead_time, leak, valve_lag, orifice_flow, sensor_offset
- actuation: gain_saturation, stiffening, hysteresis, friction, crosstalk
- body: gravity and payload (loads, in static equilibrium with the joints), thermal, cyclic_softening, creep;
  then elongation (of the finished pose)
- observation: base_tilt, camera_misalignment

Effects of other packages come last in their stage, in alphabetical order.
"""

import importlib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import entry_points

from pneutac_sim.effects.effect import STAGES, Effect
from pneutac_sim.effects.optics import OPTICS, OpticsEffect
from pneutac_sim.errors import InputError

ENTRY_POINT_GROUP = "pneutac.effects"

BUILTIN = (
    "dead_time",
    "leak",
    "valve_lag",
    "orifice_flow",
    "sensor_offset",
    "gain_saturation",
    "stiffening",
    "hysteresis",
    "friction",
    "crosstalk",
    "gravity",
    "payload",
    "thermal",
    "cyclic_softening",
    "creep",
    "elongation",
    "base_tilt",
    "camera_misalignment",
)


@cache
def all_effects() -> dict[str, Effect]:
    """Name to effect of a finger or an arm, in the order in which they act.

    Raises:
        InputError: another package offers something that is no effect, or a name twice.
    """
    found = [importlib.import_module(f"pneutac_sim.effects.{name}").EFFECT for name in BUILTIN]
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda p: p.name):
        effect = point.load()
        if not isinstance(effect, Effect):
            raise InputError(f"Entry point '{point.name}' of {ENTRY_POINT_GROUP} must be an Effect.")
        if effect.name in {e.name for e in found} | set(OPTICS):
            raise InputError(f"Two packages offer an effect named '{effect.name}'; rename one of them.")
        found.append(effect)
    return {e.name: e for stage in STAGES for e in found if e.stage == stage}


def get_effect(name: str) -> Effect | OpticsEffect:
    """One effect, of a body or of a gel's optics; raises InputError naming those that exist."""
    known = all_effects() | OPTICS
    if name not in known:
        raise InputError(f"There is no effect '{name}'; there are {', '.join(known)}.")
    return known[name]


def of_body(names: Iterable[str]) -> list[str]:
    """Those effects that act on a finger or an arm, not on the gel that it may carry."""
    return [n for n in names if n not in OPTICS]


def in_order(names: list[str]) -> list[Effect]:
    """These effects, sorted as they act."""
    known = list(all_effects())
    return [get_effect(n) for n in sorted({get_effect(n).name for n in names}, key=known.index)]
