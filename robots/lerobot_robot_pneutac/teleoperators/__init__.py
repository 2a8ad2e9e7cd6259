"""Teleoperators; LeRobot looks here for the class that a teleoperator's options name.

They are imported when they are asked for: listening to a keyboard may open a display.
"""

from importlib import import_module

_MODULES = {
    "PneutacGamepad": "velocity_teleop",
    "PneutacKeyboard": "velocity_teleop",
    "PneutacScripted": "pneutac_scripted",
    "PneutacSpacemouse": "velocity_teleop",
}


def __getattr__(name: str):
    if name not in _MODULES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
