"""What every pressure controller must do, as one sequence: for tests, and for a rig on the bench."""

import math
from collections.abc import Callable

from lerobot_robot_pneutac.hardware.parts import HardwareFault, PressureController, wait
from pneutac_sim.errors import InputError

REACH_S = 5.0
TOLERANCE = 0.05  # of the set-point
PERIOD_S = 0.05


def check_pressure_controller(controller: PressureController, kpa: float) -> None:
    """Fills a controller, not connected, to a pressure, lets the command grow old, vents, and lets go.

    Raises HardwareFault where it reported a fault, or did not do what it must; the message says what.
    """
    _must_raise(HardwareFault, controller.pressure, "measures before it is connected")
    controller.connect()
    try:
        if not getattr(controller, "max_kpa", 0.0) >= kpa:
            raise HardwareFault(f"The pressure controller has no max_kpa, or one below {kpa:g} kPa.")
        for bad in (math.nan, math.inf, getattr(controller, "min_kpa", 0.0) - 1.0):
            wanted = lambda bad=bad: controller.set_pressure(bad)  # noqa: E731
            _must_raise(InputError, wanted, f"takes a set-point of {bad}")
        low = TOLERANCE * kpa

        def filled() -> bool:
            controller.set_pressure(kpa)
            return abs(controller.pressure() - kpa) <= low

        _must(filled, f"does not reach {kpa:g} kPa within {REACH_S:g} s")
        _must(lambda: controller.pressure() <= low, "keeps its pressure though no set-point is repeated")
        _must(filled, "does not fill again after a void set-point")
        controller.vent()
        _must(lambda: controller.pressure() <= low, "does not empty when vented")
    finally:
        controller.disconnect()
    controller.vent()
    controller.disconnect()


def _must(condition: Callable[[], bool], otherwise: str) -> None:
    if not wait(condition, REACH_S, PERIOD_S):
        raise HardwareFault(f"The pressure controller {otherwise}.")


def _must_raise(error: type[Exception], call: Callable, otherwise: str) -> None:
    try:
        call()
    except error:
        return
    raise HardwareFault(f"The pressure controller {otherwise}; it must raise {error.__name__}.")
