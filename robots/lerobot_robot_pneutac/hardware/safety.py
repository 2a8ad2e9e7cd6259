"""The limits that hold below any policy, and the guard that keeps arm and chamber inside them.

`Limits` decides what becomes of an action and touches no part. The guard ends every fault in one way: arm
stopped, chamber vented.
"""

import atexit
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from lerobot_robot_pneutac.hardware.parts import (
    COMMAND_S,
    TICK_S,
    Arm,
    ArmState,
    Chambers,
    HardwareFault,
    PressureController,
    wait,
)
from lerobot_robot_pneutac.options import refuse_if
from pneutac_sim.features import MAX_SPEED_M_S, PAPER_RANGE_KPA, PRESSURES, action_limits, action_names

STOPPING_S = 0.15  # to come to rest from full speed
# Beyond the range by more than this share of it, an action is a fault of its sender and not a rounding.
EXCESS = 0.2
OVERPRESSURE = 1.15  # of the farthest set-point


@dataclass(kw_only=True)
class Limits:
    """Limits of the real robot.

    Attributes:
        action_kpa: lowest and highest pressure of an action; beyond them one is refused, within them it is
            held to the set-points above. Not an option.
    """

    speed_m_s: float = MAX_SPEED_M_S  # of the flange along each axis
    # corner (x, y, z) of the box that the flange stays in, base frame
    low_m: tuple[float, float, float] = (0.25, -0.35, 0.12)
    high_m: tuple[float, float, float] = (0.65, 0.35, 0.65)  # the opposite corner
    force_n: float = 20.0  # external force at the flange above which everything stops
    pressure_kpa: float | None = None  # highest set-point; if omitted, what the twin was measured up to
    # lowest set-point, 0 or below; if omitted, what the twin was measured down to
    vacuum_kpa: float | None = None
    pressure_rate_kpa_s: float = 100.0  # fastest change of the set-point
    # measured pressure above which everything stops, with vacuum also where it is as far below zero; if
    # omitted, 1.15 times the farthest set-point
    overpressure_kpa: float | None = None
    beyond_twin: bool = False  # whether set-points may lie beyond what the twin was measured over

    def __post_init__(self):
        self._given = self.pressure_kpa, self.vacuum_kpa, self.overpressure_kpa
        self._set_points(PAPER_RANGE_KPA)

    def _set_points(self, twin_kpa: tuple[float, float]) -> None:
        """Fills in what was left out, from the range of a twin, and checks all."""
        low, high = twin_kpa
        pressure, vacuum, over = self._given
        self.pressure_kpa = high if pressure is None else pressure
        self.vacuum_kpa = low if vacuum is None else vacuum
        farthest = max(self.pressure_kpa, -self.vacuum_kpa)
        self.overpressure_kpa = OVERPRESSURE * farthest if over is None else over
        self.action_kpa = min(low, self.vacuum_kpa), max(high, self.pressure_kpa)
        self._check()

    def of_twin(self, twin_kpa: tuple[float, float]) -> "Limits":
        """These limits for a twin that was measured over that range, kPa.

        Raises DecodingError: a given set-point lies beyond the range, and `beyond_twin` does not allow it.
        """
        low, high = twin_kpa
        pressure, vacuum, over = self._given
        beyond = (pressure is not None and pressure > high) or (vacuum is not None and vacuum < low)
        refuse_if(
            beyond and not self.beyond_twin,
            f"limits.pressure_kpa is {self.pressure_kpa:g} and limits.vacuum_kpa {self.vacuum_kpa:g}, but the"
            f" twin was measured from {low:g} to {high:g} kPa; keep to that, or give"
            " limits.beyond_twin=true.",
        )
        limits = replace(self, pressure_kpa=pressure, vacuum_kpa=vacuum, overpressure_kpa=over)
        limits._set_points(twin_kpa)
        return limits

    def _check(self) -> None:
        for f in fields(self):
            value = np.asarray(getattr(self, f.name), float)
            positive = value.ndim or value > 0 or f.name in ("vacuum_kpa", "beyond_twin")
            wrong = f"limits.{f.name} is {getattr(self, f.name)}; it must be a positive number."
            refuse_if(not (positive and np.isfinite(value).all()), wrong)
        refuse_if(
            self.speed_m_s > MAX_SPEED_M_S,
            f"limits.speed_m_s is {self.speed_m_s}; actions reach {MAX_SPEED_M_S} at most.",
        )
        refuse_if(
            self.vacuum_kpa > 0, f"limits.vacuum_kpa is {self.vacuum_kpa}; it must be 0, or below for vacuum."
        )
        refuse_if(
            len(self.low_m) != 3 or len(self.high_m) != 3 or not (np.less(self.low_m, self.high_m)).all(),
            f"limits.low_m is {self.low_m} and limits.high_m {self.high_m}; give three numbers each, the"
            " first below the second.",
        )
        refuse_if(
            self.overpressure_kpa <= max(self.pressure_kpa, -self.vacuum_kpa),
            f"limits.overpressure_kpa is {self.overpressure_kpa}; it must be above the highest set-point,"
            f" {self.pressure_kpa}, and as far from zero as the lowest, {self.vacuum_kpa}.",
        )

    def velocity(self, wanted_m_s: np.ndarray, flange_m: np.ndarray) -> np.ndarray:
        """The part of a velocity (3,) m/s that keeps the flange, now at `flange_m` (3,), in its box.

        Towards a wall the speed is at most `distance / (COMMAND_S + STOPPING_S)`: also where this is the last
        command ever sent, the arm has come to rest before the wall. Outside the box only the way back is
        open.
        """
        room_s = COMMAND_S + STOPPING_S
        up = np.clip((np.asarray(self.high_m) - flange_m) / room_s, 0.0, self.speed_m_s)
        down = np.clip((flange_m - np.asarray(self.low_m)) / room_s, 0.0, self.speed_m_s)
        return np.clip(wanted_m_s, -down, up)

    def pressure(self, wanted_kpa: np.ndarray, last_kpa: np.ndarray, elapsed_s: float) -> np.ndarray:
        """The set-points (kPa) that follow `last_kpa` after `elapsed_s` on the way to the wanted ones."""
        wanted = np.clip(wanted_kpa, self.vacuum_kpa, self.pressure_kpa)
        step = self.pressure_rate_kpa_s * min(elapsed_s, COMMAND_S)
        return np.clip(wanted, last_kpa - step, last_kpa + step)

    def broken_by(self, force_n: float, pressure_kpa: float | np.ndarray) -> str | None:
        """What a measurement, of the pressure one a chamber, breaks, as one sentence, or None."""
        chambers = np.atleast_1d(pressure_kpa).tolist()
        if not (math.isfinite(force_n) and np.isfinite(chambers).all()):
            read = ", ".join(map(str, chambers))
            return f"The force reads {force_n} N and the pressure {read} kPa; check the sensors."
        if force_n > self.force_n:
            return (
                f"The force at the flange is {force_n:.1f} N, above limits.force_n = {self.force_n:g};"
                " move the arm free by hand."
            )
        for number, kpa in enumerate(chambers, 1):
            where = f" in chamber {number}" if len(chambers) > 1 else ""
            if kpa > self.overpressure_kpa or (self.vacuum_kpa < 0 and kpa < -self.overpressure_kpa):
                side = "above" if kpa > 0 else "farther below zero than"
                return (
                    f"The pressure{where} is {kpa:.1f} kPa, {side} limits.overpressure_kpa ="
                    f" {self.overpressure_kpa:g}; check valve and sensor."
                )
        return None


def why_refused(
    values: np.ndarray, action_kpa: tuple[float, float] = PAPER_RANGE_KPA, chambers: int = 1
) -> str | None:
    """Why an action (3 + C,) is not carried out at all, or None; a small excess is clipped, not refused."""
    names, (lowest, highest) = action_names(chambers), action_limits(action_kpa, chambers)
    excess = EXCESS * (highest - lowest)
    for name, value, low, high, beyond in zip(names, values, lowest, highest, excess, strict=True):
        if not np.isfinite(value):
            return f"{name} is {value}"
        if not low - beyond <= value <= high + beyond:
            return f"{name} is {value:.4g}, far outside {low:g} to {high:g}"
    return None


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
