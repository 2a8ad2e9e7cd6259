"""What an effect is: one physical mechanism, with parameters, that a twin may have or lack.

An effect changes one signal of the finger pipeline, in place, by a compiled function

    run(x, dt, theta, conditions, state)

with n samples at once (a whole recording) or one (a control step of the environment):

- `x` (n, channels): the signal of the effect's stage, see `SIGNALS`.
- `dt` (n,): seconds since the sample before. At the first sample of a trial it is infinite: the device has
  rested at that input for ever, so that `exp(-dt / tau)` is zero and a lag has caught up by itself.
- `theta` (p,): the effect's parameters in the order of `Effect.parameters`.
- `conditions` (n, k): the columns named in `Effect.columns`.
- `state`: a float array of `Effect.state_size(channels)` numbers, all zero for a new device. It is kept from
  call to call and from trial to trial, so what the material remembers (its largest strain, its cycles) lives
  on; what a rest wipes out, wipe out where `dt` is infinite.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from pneutac_sim.errors import InputError
from pneutac_sim.twin import Value

# Stage to the signals that its effects may act on; the first is the default. `loads` are forces in N, base
# frame: tip x, y, z, then weight of the body x, y, z, spread evenly over its length.
SIGNALS = {
    "pneumatics": ("pressure",),  # kPa, a channel a chamber
    "actuation": ("pressure",),  # kPa that bends, a channel a chamber
    "body": ("joints", "loads", "markers"),  # joints: rad less the curl at rest, a channel a joint (and axis)
    "observation": ("markers",),  # tip x, y, z in mm, bend towards +z and towards +y in rad
}
STAGES = tuple(SIGNALS)

# Division by zero gives inf, as in NumPy: `exp(-dt / 0)` is then the zero that a neutral lag needs.
kernel = njit(cache=True, error_model="numpy")


@dataclass(frozen=True)
class Parameter:
    """A number that calibration may fit.

    Attributes:
        name: with its unit, such as `fill_time_s`.
        unit: as shown to people; empty for a ratio.
        default: where a fit starts: a mild but visible effect.
        lower: least value that physics allows.
        upper: largest value.
        neutral: value at which the effect (or this part of it) does nothing; may lie outside the bounds.
        log: True where the parameter is positive and its magnitude is what matters.
        fixed: True for a constant that a user may set and that data cannot tell from another parameter.
        range_power: default and bounds are in units of (largest pressure in kPa) ** range_power.
        step: share of the range between bounds by which a fit moves it to see what it does; larger where the
            answer comes in jumps.
    """

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    neutral: float = 0.0
    log: bool = False
    fixed: bool = False
    range_power: int = 0
    step: float = 1e-5

    def __post_init__(self):
        if not (self.lower <= self.default <= self.upper and self.lower < self.upper):
            raise InputError(
                f"Parameter '{self.name}': default {self.default} must lie in [{self.lower}, {self.upper}]."
            )
        if self.log and self.lower <= 0:
            raise InputError(f"Parameter '{self.name}' is logarithmic; its lower bound must be above zero.")

    def limits(self, pressure_range_kpa: float) -> tuple[float, float, float]:
        """Default, lower and upper for a device driven up to this pressure."""
        scale = pressure_range_kpa**self.range_power
        return self.default * scale, self.lower * scale, self.upper * scale


@dataclass(frozen=True)
class Effect:
    """One physical mechanism.

    Attributes:
        name: as the user types it.
        stage: `pneumatics`, `actuation`, `body` or `observation`.
        parameters: in the order in which `run` takes them.
        run: compiled function, see the module's text.
        summary: one sentence for a newcomer, with `{device}` and `{parameter}` placeholders.
        experiment: what to record to see the effect apart from its rivals.
        columns: condition columns that it needs. These are computed: `session_time_s`, `length_mm`,
            `bending_pressure_kpa` (the pressure that reaches the body, where `signal` is `markers`), and
            `other_1_kpa` to `other_3_kpa` where the recording has further `*_kpa` columns.
        signal: what it acts on; empty for the stage's first signal.
        state_size: number of channels to number of state values.
        derive: parameter values to further values that `summary` shows.
    """

    name: str
    stage: str
    parameters: tuple[Parameter, ...]
    run: Callable
    summary: str
    experiment: str
    columns: tuple[str, ...] = ()
    signal: str = ""
    state_size: Callable[[int], int] = field(default=lambda channels: 0)
    derive: Callable[[dict[str, float]], dict[str, float]] = field(default=lambda values: {})

    def __post_init__(self):
        if self.stage not in STAGES:
            raise InputError(
                f"Effect '{self.name}': stage '{self.stage}' must be one of {', '.join(STAGES)}."
            )
        if not self.signal:
            object.__setattr__(self, "signal", SIGNALS[self.stage][0])
        if self.signal not in SIGNALS[self.stage]:
            raise InputError(
                f"Effect '{self.name}': signal '{self.signal}' must be one of "
                f"{', '.join(SIGNALS[self.stage])} in stage '{self.stage}'."
            )

    def start(self, pressure_range_kpa: float) -> dict[str, Value]:
        """Parameter values with which a fit starts."""
        return {p.name: Value(p.limits(pressure_range_kpa)[0]) for p in self.parameters}

    def neutral(self) -> dict[str, Value]:
        """Parameter values at which the effect does nothing."""
        return {p.name: Value(p.neutral) for p in self.parameters}

    def describe(self, values: dict[str, float], device: str = "finger") -> str:
        """The summary with numbers, e.g. of a fit."""
        return self.summary.format(device=device, **values, **self.derive(values))

    def apply(
        self,
        x: np.ndarray,
        dt: np.ndarray,
        values: dict[str, float] | None = None,
        conditions: np.ndarray | None = None,
        state: np.ndarray | None = None,
    ) -> np.ndarray:
        """Runs the effect on a copy of one signal; for trying it out and for tests.

        Args:
            x: (n,) or (n, channels).
            dt: (n,) seconds; the first is taken as infinite where `state` is not given.
            values: parameters; those left out take their default for a pressure range of max |x|.
            conditions: (n, k) in the order of `columns`.
            state: continues from there and is updated.

        Returns:
            The changed signal, shaped as `x`.
        """
        out = np.array(x, dtype=float).reshape(len(x), -1)
        dt = np.array(dt, dtype=float)
        if state is None:
            state = np.zeros(self.state_size(out.shape[1]))
            dt[0] = math.inf
        start = self.start(float(np.abs(out).max()) or 1.0)
        theta = np.array([(values or {}).get(p.name, start[p.name].value) for p in self.parameters])
        k = np.zeros((len(out), 0)) if conditions is None else np.asarray(conditions, dtype=float)
        self.run(out, dt, theta, np.ascontiguousarray(k.reshape(len(out), -1)), state)
        return out.reshape(np.shape(x))
