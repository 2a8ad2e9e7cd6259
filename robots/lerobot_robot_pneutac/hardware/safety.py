"""Keeps arm and chamber inside their limits, and ends every fault in one way: arm stopped, chamber vented."""

import atexit
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import numpy as np

from lerobot_robot_pneutac.hardware.chambers import Chambers
from lerobot_robot_pneutac.hardware.limits import Limits, why_refused
from lerobot_robot_pneutac.hardware.parts import (
    COMMAND_S,
    TICK_S,
    Arm,
    ArmState,
    HardwareFault,
    PressureController,
    wait,
)
from pneutac_sim.features import PRESSURES

VENT_S = 1.0  # without an action for so long the chamber is vented
HOLD_S = 0.5 * COMMAND_S  # without an action for so long the watchdog holds the pressure
REFUSALS = 5  # so many refused actions among the last `RECENT` are a fault
RECENT = 20
ARM_S = 0.2  # an arm that has not answered for so long is lost
MOVE_S = 3.0  # the same of a command, which may clear a reflex first
HALT_S = 0.05  # how long a halt waits for the arm to say that it stopped
ROUNDING_KPA = 1e-3  # by which an action in single precision may be beyond a limit
CLOSE_S = 1.0  # how long closing waits for each thread

logger = logging.getLogger(__name__)


class Guard:
    """Stands between whoever sends actions and the parts.

    Two threads run next to the control loop. The watchdog stops the arm when no action was carried out for
    `COMMAND_S`, holds the pressure, and vents the chamber after `VENT_S`; the next action starts both again.
    The monitor reads force and pressure all the time. A broken limit or a part that fails is a fault: arm
    stopped, chamber vented, and every later call raises it until the robot is connected again.

    Of the arm `state` and `stop`, of the controller all but connecting is called from these threads too.

    Attributes:
        limits: see `Limits`.
        fault: the first fault, or None.
        refused: actions refused so far.
    """

    def __init__(self, arm: Arm, pressure: PressureController | Chambers, limits: Limits):
        self.limits = limits
        self.fault: HardwareFault | None = None
        self.refused = 0
        self._arm, self._pressure = arm, Chambers.of(pressure)
        self._recent: deque[bool] = deque(maxlen=RECENT)  # whether each of the last actions was refused
        self._vented_kpa = np.zeros(len(self._pressure))
        self._target_kpa = self._vented_kpa
        self._last_s = time.monotonic()
        self._moving = self._inflated = self._warned = False
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=f, name=f"pneutac-{f.__name__.strip('_')}", daemon=True)
            for f in (self._watchdog, self._monitor)
        ]

    def start(self) -> None:
        """Starts watching; both parts are connected."""
        # Python's own exit is the last line where a second Ctrl-C cuts an orderly end short.
        atexit.register(self._last_line)
        for thread in self._threads:
            thread.start()

    def look(self) -> tuple[ArmState, np.ndarray]:
        """State of the arm and pressure (chambers,) in kPa.

        Raises HardwareFault: a part failed or a limit is broken, now or before.
        """
        with self.failing("reading arm and pressure"):
            state, kpa = within(ARM_S, "The arm", self._arm.state), self._pressure.pressure()
            breach = self.limits.broken_by(state.force_n, kpa)
            if breach:
                raise HardwareFault(breach)
            return state, kpa

    def act(self, values: np.ndarray) -> np.ndarray:
        """Carries out an action (3 + chambers,), flange velocity m/s and pressures kPa, within the limits.

        Returns what was carried out; zeros, the arm at rest and the chamber vented, where it was refused.

        Raises HardwareFault: as `look`, or `REFUSALS` of the last `RECENT` actions were refused.
        """
        state, _ = self.look()
        with self.failing("sending an action"):
            reason = why_refused(values, self.limits.action_kpa, len(self._pressure))
            self._recent.append(reason is not None)
            if reason:
                return self._refuse(reason, len(values))
            self._warn_limited(values[PRESSURES])
            now = time.monotonic()
            self._target_kpa = self.limits.pressure(values[PRESSURES], self._target_kpa, now - self._last_s)
            velocity = self.limits.velocity(values[:3], state.flange_m)
            self._last_s = now
            self._moving = self._inflated = True
            within(MOVE_S, "The arm", self._arm.move, velocity)
            self._pressure.set_pressure(self._target_kpa)
        if self.fault:  # arose meanwhile in another thread: it must have the last word
            self.halt()
            raise self.fault
        return np.append(velocity, self._target_kpa)

    def fail(self, fault: HardwareFault) -> None:
        """Makes a fault known: everything halts, and later calls raise it. The first one is stored."""
        if self.fault is None:
            self.fault = fault
            logger.error("%s The arm is stopped and the chamber vented.", fault)
        self.halt()

    @contextmanager
    def failing(self, doing: str) -> Iterator[None]:
        """While a part is used: whatever is raised halts everything at once, until the guard is closed.

        Raises HardwareFault: in place of any other exception of the part, and on entering after a fault.
        """
        if self.fault:
            raise self.fault
        try:
            yield
        except BaseException as e:
            if self._closed.is_set():
                raise
            if not isinstance(e, Exception):  # Ctrl-C: LeRobot saves its data first and only then disconnects
                self.halt()
                raise
            fault = e if isinstance(e, HardwareFault) else HardwareFault(f"{doing.capitalize()} failed: {e}.")
            self.fail(fault)
            if fault is e:
                raise
            raise fault from e

    def halt(self) -> None:
        """Stops the arm and vents the chamber, now; never raises and does not wait for a part that hangs."""
        self._rest()
        stop = threading.Thread(target=_quietly, args=(self._arm.stop,), daemon=True)
        stop.start()
        _quietly(self._pressure.vent)
        stop.join(HALT_S)

    def close(self) -> None:
        self._closed.set()
        self.halt()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(CLOSE_S)
        atexit.unregister(self._last_line)

    def _last_line(self) -> None:
        """Halts without a thread of its own, which an ending interpreter would refuse."""
        self._closed.set()
        self._rest()
        _quietly(self._pressure.vent)
        _quietly(self._arm.stop)
        _quietly(self._pressure.disconnect)  # returns when the vent is sent

    def _rest(self) -> None:
        """Before a vent, or the watchdog, which holds the pressure, would fill the chamber again."""
        self._target_kpa = self._vented_kpa
        self._moving = self._inflated = False

    def _warn_limited(self, wanted_kpa: np.ndarray) -> None:
        """Logs the first set-point that the limits hold back; later ones show in what `act` returns."""
        low, high = self.limits.vacuum_kpa, self.limits.pressure_kpa
        beyond = (wanted_kpa < low - ROUNDING_KPA) | (wanted_kpa > high + ROUNDING_KPA)
        if not self._warned and beyond.any():
            self._warned = True
            text = (
                "A set-point of %.4g kPa is clipped to the limits, %g to %g kPa; later ones are not logged."
            )
            logger.warning(text, wanted_kpa[beyond][0], low, high)

    def _refuse(self, reason: str, size: int) -> np.ndarray:
        self.refused += 1
        logger.warning("Action refused: %s. The arm stops and the chamber is vented.", reason)
        self.halt()
        self._last_s = time.monotonic()  # the next pressure begins at zero
        if sum(self._recent) >= REFUSALS:
            raise HardwareFault(
                f"{REFUSALS} of the last {len(self._recent)} actions were refused, the last because {reason}."
            )
        return np.zeros(size)

    def _watchdog(self) -> None:
        while not self._closed.wait(TICK_S):
            idle_s = time.monotonic() - self._last_s
            if self._moving and idle_s > COMMAND_S:
                self._moving = False
                self._or_fail("Stopping the arm", self._arm.stop)
            if self._inflated and idle_s > VENT_S:
                logger.warning("No action for %.1f s: the chamber is vented.", idle_s)
                self._inflated, self._target_kpa = False, self._vented_kpa
                self._or_fail("Venting", self._pressure.vent)
            elif self._inflated and idle_s > HOLD_S:  # the controller would take it as void after `COMMAND_S`
                self._or_fail("Holding the pressure", lambda: self._pressure.set_pressure(self._target_kpa))
                if not self._inflated:  # vented meanwhile by another thread
                    _quietly(self._pressure.vent)

    def _or_fail(self, doing: str, act: Callable[[], None]) -> None:
        """Makes whatever a part raises a fault: in a thread of its own nobody else would hear of it."""
        try:
            act()
        except Exception as e:
            if not self._closed.is_set():
                self.fail(HardwareFault(f"{doing} failed: {e}."))

    def _monitor(self) -> None:
        while self.fault is None and not self._closed.wait(TICK_S):
            try:
                self.look()
            except HardwareFault:
                return  # made known by `look`


def within(limit_s: float, who: str, call: Callable[..., Any], *args: Any) -> Any:
    """What a call returns or raises; one that hangs is left to its own thread.

    Raises HardwareFault: it takes longer than `limit_s`.
    """
    outcome: Future = Future()

    def run() -> None:
        try:
            outcome.set_result(call(*args))
        except BaseException as e:  # for the caller, whatever it is
            outcome.set_exception(e)

    thread = threading.Thread(target=run, name=f"pneutac-{who}", daemon=True)
    thread.start()
    if not wait(outcome.done, limit_s, pause=thread.join):
        raise HardwareFault(f"{who} has not answered for {limit_s:g} s; check its cable and its controller.")
    return outcome.result()


def _quietly(call: Callable[[], None]) -> None:
    try:
        call()
    except Exception as e:
        logger.error("%s failed: %s", getattr(call, "__qualname__", call), e)
