"""The inverse pipeline: the pressure for a wanted bend, with all effects compensated.

Hysteresis, creep and air are inverted together by looking ahead on the twin: of `STEPS` commands those are
taken with which its bend comes nearest to the target, changes of the command costing a little, and the first
one is sent (a receding horizon; Gauss and Newton's method, whose derivative is the response to a step of
all commands). Where the bend is measured, a slow offset on the model's is learnt (as offset-free predictive
control has it, Pannocchia and Rawlings, AIChE Journal 49, 2003), and what comes faster than any effect of
the twin is detected as a load.
"""

import math
from collections.abc import Mapping

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.twin import Twin

STEPS = 12  # of the look ahead
HORIZON_S = 0.6  # which a chamber's filling and its line's delay fit into
SMOOTH = 0.15  # weight of a change of the command, bent by the gain, against the same error
ROUNDS = 2
PROBE_KPA = 0.3  # by which the commands are raised to see what it does
OFFSET_S = 1.0  # time constant with which a measured offset is believed
# The same of how far a reading usually is from it; as much again before a load can be detected.
USUAL_S = 10.0
LOAD_STEPS = 3  # readings in a row, on one side, ...
LOAD_USUAL = 4.0  # ... that are so many times as far from model and offset as usual are a load, ...
LATE_S = 0.06  # ... unless the bend is moving and is merely so much early or late


def bend_angle(markers: np.ndarray, by: str = "tip") -> np.ndarray:
    """Bend (...,) in rad of markers (..., 5) as the pipeline gives them.

    By `tip`, that of the circular arc from the base to where the tip is, 2 atan2(z, x); by `angle`, that of
    the tip's direction itself.
    """
    markers = np.asarray(markers)
    return markers[..., 3] if by == "angle" else 2 * np.arctan2(markers[..., 2], markers[..., 0])


def bend_is_by(twin: Twin) -> str:
    """Which bend (`bend_angle`) a twin was calibrated to: `angle`, or `tip` where tips were measured."""
    units = [entry["unit"] for entry in twin.history if entry.get("unit") in ("mm", "rad", "1/m")]
    return "angle" if units and units[-1] != "mm" else "tip"


class BendController:
    """Commands pressure so that a free finger has the wanted bend, one control step at a time.

    Args:
        twin: a finger of one chamber.
        dt_s: length of a control step.
        conditions: what its effects ask for, such as `temperature_c`.

    Attributes:
        by: which bend it is, see `bend_angle`.
        reach_rad: smallest and largest bend of a finger that has long been at the ends of its pressure range.
        offset_rad: by which the measured bend is off the model's, learnt by `observe`.
        residual_rad: by which the last measured bend was off model and offset.
        loaded: whether something else than its pressure bends the finger, by the last measured bends.

    Raises InputError: a device of another kind, or a condition is missing.
    """

    def __init__(self, twin: Twin, dt_s: float, conditions: Mapping[str, float] | None = None):
        if twin.device != "finger":
            raise InputError(
                f"The twin's device is '{twin.device}'; bend is commanded of a finger of one chamber."
            )
        if not 0 < dt_s < math.inf:
            raise InputError(f"dt_s={dt_s} must be a positive number of seconds.")
        self._model = PressurePipeline(twin, conditions)
        self._dt_s, self._plan_s = dt_s, max(dt_s, HORIZON_S / STEPS)
        self.by, self._range_kpa = bend_is_by(twin), twin.pressure_range_kpa
        ends = [self._rested(kpa) for kpa in self._range_kpa]
        self.reach_rad = (min(ends), max(ends))
        self.reset()

    def reset(self, pressure_kpa: float = 0.0) -> None:
        """The finger has long been at this pressure."""
        self._model.reset(pressure_kpa, same_session=True)
        self._bend_rad = float(bend_angle(self._model.place(self._model.rest(), self._dt_s), self.by))
        self._plan, self._sent_kpa = np.full(STEPS, pressure_kpa), pressure_kpa
        self.offset_rad = self.residual_rad = 0.0
        self._rate_rad_s = 0.0
        self._seen, self._usual_rad2, self._streak, self.loaded = 0, 0.0, 0, False

    def _rested(self, kpa: float) -> float:
        self._model.reset(kpa)
        return float(bend_angle(self._model.place(self._model.rest(), self._dt_s), self.by))

    @property
    def plan_times_s(self) -> np.ndarray:
        """(STEPS,) from now, at which `command` takes the targets."""
        return self._plan_s * np.arange(1, STEPS + 1)

    def command(self, target_rad: float | np.ndarray) -> float:
        """The pressure to send now; the model goes one control step on with it.

        Args:
            target_rad: bend at each of `plan_times_s`, (STEPS,); one number is held.

        Returns:
            kPa, within the twin's range.

        Raises InputError: the target is not finite.
        """
        kpa = self.plan(target_rad)
        self.follow(kpa)
        return kpa

    def plan(self, target_rad: float | np.ndarray) -> float:
        """As `command`, but the model waits for `follow`, which says what was sent in the end."""
        target = np.broadcast_to(np.asarray(target_rad, float), (STEPS,)) - self.offset_rad
        if not np.isfinite(target).all():
            raise InputError("The target bend is not a finite number of radians.")
        plan = self._plan
        for _ in range(ROUNDS):
            plan = self._nearer(plan, target)
        self._plan = plan
        return float(plan[0])

    def follow(self, pressure_kpa: float) -> None:
        """One control step under this command, planned or not."""
        if pressure_kpa != self._plan[0]:
            self._plan = np.full(STEPS, pressure_kpa)
        self._sent_kpa = pressure_kpa
        markers = self._model.place(self._model.step(pressure_kpa, self._dt_s), self._dt_s)
        before, self._bend_rad = self._bend_rad, float(bend_angle(markers, self.by))
        self._rate_rad_s = (self._bend_rad - before) / self._dt_s
        keep = 1.0 - self._dt_s / self._plan_s  # the plan is of longer steps than the control
        self._plan = keep * self._plan + (1.0 - keep) * np.append(self._plan[1:], self._plan[-1])

    @property
    def predicted_rad(self) -> float:
        """Bend that is expected now, after the last command."""
        return self._bend_rad + self.offset_rad

    def observe(self, bend_rad: float) -> None:
        """Takes a measured bend, after the `command` of the same control step.

        What is far from model and offset is no offset: nothing is learnt of it.

        Raises InputError: the bend is not finite.
        """
        if not math.isfinite(bend_rad):
            raise InputError(f"The measured bend is {bend_rad}; it must be a finite number of radians.")
        self.residual_rad = r = bend_rad - self.predicted_rad
        self._seen += 1
        enough = self._seen * self._dt_s > USUAL_S
        usual = LOAD_USUAL * math.sqrt(self._usual_rad2) + LATE_S * abs(self._rate_rad_s)
        if enough and abs(r) > usual:
            side = 1 if r > 0 else -1
            self._streak = self._streak + side if self._streak * side > 0 else side
        else:
            self._streak = 0
            self._usual_rad2 += max(1 / self._seen, self._dt_s / USUAL_S) * (r * r - self._usual_rad2)
            self.offset_rad += self._dt_s / (OFFSET_S + self._dt_s) * r
        self.loaded = abs(self._streak) >= LOAD_STEPS

    def _nearer(self, plan: np.ndarray, target: np.ndarray) -> np.ndarray:
        low, high = self._range_kpa
        probe = PROBE_KPA if plan.mean() < 0.5 * (low + high) else -PROBE_KPA
        bends = self._bends(plan)
        response = (self._bends(plan + probe) - bends) / probe
        pulse = np.diff(response, prepend=0.0)
        lag = np.subtract.outer(np.arange(STEPS), np.arange(STEPS))
        derivative = np.where(lag >= 0, pulse[np.maximum(lag, 0)], 0.0)
        change = np.eye(STEPS) - np.eye(STEPS, k=-1)
        costly = SMOOTH * abs(response[-1])
        before = np.append(self._sent_kpa, np.zeros(STEPS - 1))
        A = np.vstack([derivative, costly * change])
        b = np.append(target - bends, costly * (before - change @ plan))
        return np.clip(plan + np.linalg.lstsq(A, b, rcond=None)[0], low, high)

    def _bends(self, plan: np.ndarray) -> np.ndarray:
        return bend_angle(self._model.predict(plan, self._plan_s), self.by)


def pressure_for(
    twin: Twin, bend_rad: np.ndarray, dt_s: float, conditions: Mapping[str, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Commands (n,) in kPa with which a finger follows a bend known ahead, and the bend expected of them.

    The finger of one chamber is free and long at rest without pressure; `bend_rad` (n,) is wanted at the end
    of each control step of `dt_s`. `conditions` are what its effects ask for.

    Raises InputError where a bend is out of the finger's reach, or as `BendController`.
    """
    wanted, control = np.asarray(bend_rad, float), BendController(twin, dt_s, conditions)
    low, high = control.reach_rad
    if wanted.ndim != 1 or not len(wanted) or not np.isfinite(wanted).all():
        raise InputError("bend_rad must be one row of finite numbers.")
    if wanted.min() < low or wanted.max() > high:
        least, most = twin.pressure_range_kpa
        raise InputError(
            f"The bend goes from {wanted.min():.3g} to {wanted.max():.3g} rad; between {least:g} and {most:g}"
            f" kPa this finger reaches {low:.3g} to {high:.3g} rad."
        )
    times, ahead = dt_s * np.arange(1, len(wanted) + 1), control.plan_times_s
    kpa, bends = np.empty(len(wanted)), np.empty(len(wanted))
    for i, t in enumerate(times):
        kpa[i] = control.command(np.interp(t - dt_s + ahead, times, wanted))
        bends[i] = control.predicted_rad
    return kpa, bends
