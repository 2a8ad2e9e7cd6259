"""Finds pressure controllers: the built-in ones, and those that other packages add through an entry point."""

import importlib
import inspect
from importlib.metadata import entry_points

from lerobot_robot_pneutac.hardware.parts import PressureController
from pneutac_sim.errors import InputError, load_entry_point, unknown_names

ENTRY_POINT_GROUP = "pneutac.pressure_controllers"

_HERE = "lerobot_robot_pneutac.hardware"
BUILTIN = {
    "pneutac_serial": (f"{_HERE}.pneutac_serial", "PneutacSerial"),
    "text_serial": (f"{_HERE}.serial_pressure", "TextSerial"),
    "simulated": (f"{_HERE}.simulated", "SimulatedPressure"),
}
METHODS = ("connect", "set_pressure", "pressure", "vent", "disconnect")


def pressure_controller_types() -> list[str]:
    """The known types: the built-in ones first, then those of other packages in alphabetical order.

    Raises InputError: two packages offer one name.
    """
    names = [*BUILTIN, *sorted(p.name for p in entry_points(group=ENTRY_POINT_GROUP))]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"Two packages offer a pressure controller '{name}'; rename one of them.")
    return names


def make_pressure_controller(type: str, **options) -> PressureController:
    """A pressure controller of a known type, not yet connected, made with its class's own options.

    Raises InputError: there is no such type, an option is unknown, missing or bad, or a package's entry point
    is no pressure controller.
    """
    known = pressure_controller_types()
    if type not in known:
        raise InputError(f"There is no pressure controller '{type}'; there are {', '.join(known)}.")
    if type in BUILTIN:
        module, name = BUILTIN[type]
        cls = getattr(importlib.import_module(module), name)
    else:
        (point,) = entry_points(group=ENTRY_POINT_GROUP, name=type)
        cls = load_entry_point(point)
        missing = [m for m in METHODS if not callable(getattr(cls, m, None))]
        if missing:
            raise InputError(f"The pressure controller '{type}' has no method {', '.join(missing)}.")
    parameters = inspect.signature(cls).parameters
    named = {n: p for n, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}
    needed = [name for name, p in named.items() if p.default is p.empty]
    faults = [f"option '{name}' is missing; give it." for name in needed if name not in options]
    if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        faults = unknown_names(options, named, "option") + faults
    try:
        for fault in faults:
            raise InputError(fault)
        return cls(**options)
    except InputError as e:
        raise InputError(f"The pressure controller '{type}': {e}") from e
