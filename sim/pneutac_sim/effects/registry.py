"""Finds effects: the library's own, and those that other packages add through an entry point.

Order within a stage (it matters: a leak is slowed by the lag behind it):

- pneumatics: leak, valve_lag, orifice_flow, valve_slew, air_resonance, dead_time, sensor_offset
- drive: gain_saturation, stiffening, hysteresis, friction, crosstalk
- load (in static equilibrium with the joints): gravity, payload
- material: twist, thermal, cyclic_softening, creep; then elongation (of the finished pose)
- observation: base_tilt, camera_misalignment, curvature_reading
- gel: registration_shift, gel_creep
- light: near_light, photometric_nonlinearity, shadow, rest_colour, illumination_drift

Effects of other packages come last in their stage, in alphabetical order, then laws (`laws`).
"""

import difflib
import importlib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import entry_points

from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.effect import STAGES, Effect
from pneutac_sim.effects.laws import is_law, law, law_names
from pneutac_sim.effects.sensor_effect import SensorEffect
from pneutac_sim.errors import InputError, load_entry_point

ENTRY_POINT_GROUP = "pneutac.effects"

# A delay commutes with all of the air, and comes last: what it delays is smooth there, while a delayed step
# that comes between two rows would fill a valve from the next row on.
BUILTIN = """
    leak valve_lag orifice_flow valve_slew air_resonance dead_time sensor_offset gain_saturation
    stiffening hysteresis friction crosstalk gravity payload twist thermal
    cyclic_softening creep elongation base_tilt camera_misalignment curvature_reading registration_shift
    gel_creep near_light photometric_nonlinearity shadow rest_colour illumination_drift
""".split()


@cache
def all_effects() -> dict[str, Effect]:
    """Name to effect, in the order in which they act.

    Raises InputError: another package offers something that does not load or is no effect, or a name twice.
    """
    found = [importlib.import_module(f"pneutac_sim.effects.{name}").EFFECT for name in BUILTIN]
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda p: p.name):
        effect = load_entry_point(point)
        if not isinstance(effect, BodyEffect | SensorEffect):
            raise InputError(
                f"Entry point '{point.name}' of {ENTRY_POINT_GROUP} must be a BodyEffect or a SensorEffect."
            )
        if effect.name in {e.name for e in found}:
            raise InputError(f"Two packages offer an effect named '{effect.name}'; rename one of them.")
        found.append(effect)
    return {e.name: e for stage in STAGES for e in found if e.stage == stage}


def body_effects() -> dict[str, BodyEffect]:
    """Effects of a finger or an arm."""
    return {n: e for n, e in all_effects().items() if isinstance(e, BodyEffect)}


def sensor_effects() -> dict[str, SensorEffect]:
    """Effects of a touch sensor."""
    return {n: e for n, e in all_effects().items() if isinstance(e, SensorEffect)}


def get_effect(name: str) -> Effect:
    """One effect or law; raises InputError, with the nearest name, where there is none."""
    if is_law(name):
        return law(name)
    known = all_effects()
    if name not in known:
        close = difflib.get_close_matches(name, [*known, *law_names()], n=1)
        meant = f"did you mean '{close[0]}'?" if close else "`pneutac effects list` shows those that exist."
        raise InputError(f"There is no effect '{name}'; {meant}")
    return known[name]


def of_body(names: Iterable[str]) -> list[str]:
    """Those that act on a finger or an arm, not on the gel that it may carry."""
    known = sensor_effects()
    return [n for n in names if n not in known]


def of_sensor(names: Iterable[str]) -> list[str]:
    """The effects among these that act on a touch sensor."""
    known = sensor_effects()
    return [n for n in names if n in known]


def in_order(names: Iterable[str]) -> list[Effect]:
    """These effects, each once, sorted as they act; raises InputError where one does not exist."""
    order = [*all_effects(), *law_names()]

    def place(effect: Effect) -> tuple[int, str]:
        structure, _, instance = effect.name.partition(" #")
        return order.index(structure), instance

    return sorted((get_effect(n) for n in set(names)), key=place)
