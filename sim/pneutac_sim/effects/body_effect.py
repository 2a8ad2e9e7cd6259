"""Effects of a finger or an arm: each changes one signal of the finger pipeline.

It does so by a compiled function

    run(x, dt, theta, conditions, state)

in place, with n samples at once (a whole recording) or one (a control step of the environment):

- `x` (n, channels): the signal of the effect's stage, see `SIGNALS`.
- `dt` (n,): seconds since the sample before. At the first sample of a trial it is infinite: the device has
  rested at that input for ever, so that `exp(-dt / tau)` is zero and a lag has caught up by itself.
- `theta` (p,): the effect's parameters in the order of `BodyEffect.parameters`.
- `conditions` (n, k): the columns named in `BodyEffect.columns`.
- `state`: a float array of `BodyEffect.state_size(channels)` numbers, all zero for a new device. It stays
  from call to call and from trial to trial, so what the material remembers (its largest strain, its cycles)
  lives on; what a rest wipes out, wipe out where `dt` is infinite.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from pneutac_sim.effects.effect import BODY_STAGES, Effect
from pneutac_sim.errors import InputError

# Stage to the signals that its effects may act on; the first is the default.
SIGNALS = {
    "pneumatics": ("pressure",),  # kPa, a channel a chamber
    "drive": ("pressure",),  # kPa that bends, a channel a chamber
    "load": ("loads",),  # N, base frame: tip x, y, z, then weight of the body x, y, z, spread over its length
    # joints: rad less the curl at rest, a channel a joint (and axis); markers: where the tip truly is,
    # x, y, z in mm, bend towards +z and towards +y in rad
    "material": ("joints", "markers"),
    # markers: the same, as it is measured; mount: the same, by where the base stands in the frame of
    # measurement, so that the device itself is moved
    "observation": ("markers", "mount"),
}

# Division by zero gives inf, as in NumPy: `exp(-dt / 0)` is then the zero that a neutral lag needs.
# Several run at once in threads.
kernel = njit(cache=True, error_model="numpy", nogil=True)


@kernel
def in_lines(x, state, rows):
    """What a step through straight lines takes: rows of memory, and the input behind the one before it.

    Returns `state` as (rows, channels), whose row 1 is the input (channels,) before, and that with x (n + 1,
    channels). Entry by entry, as Numba takes seconds to compile the check of the shapes of whole arrays.
    """
    n, channels = x.shape
    s, f = state.reshape(rows, channels), np.empty((n + 1, channels))
    for i in range(channels):
        f[0, i] = s[1, i]
    for t in range(n):
        for i in range(channels):
            f[t + 1, i] = x[t, i]
    return s, f


@kernel
def replace_by(x, y, s, f):
    """Writes the output y over the input x (n, channels), and the last of f (n + 1, channels) into memory."""
    n, channels = x.shape
    for t in range(n):
        for i in range(channels):
            x[t, i] = y[t, i]
    for i in range(channels):
        s[1, i] = f[n, i]


REFERENCE_C = 23.0  # temperature of the laws, and of a recording without one


@dataclass(frozen=True, kw_only=True)
class BodyEffect(Effect):
    """One mechanism of a finger or an arm."""

    stages = BODY_STAGES

    run: Callable  # compiled function, see the module's text; it takes the parameters in their order
    # condition columns that it needs. These are computed: `session_time_s`, `length_mm`,
    # `bending_pressure_kpa` (the pressure that reaches the body, where `signal` is `markers`), and
    # `other_1_kpa` to `other_3_kpa` where the recording has further `*_kpa` columns
    columns: tuple[str, ...] = ()
    signal: str = ""  # what it acts on; empty for the stage's first signal
    state_size: Callable[[int], int] = lambda channels: 0  # number of channels to number of state values
    # of the pneumatics: an error of the pressure gauge. It lies between the measured pressure and the true
    # one, so it acts where the measured pressure is the input too
    of_gauge: bool = False
    # whether it acts on each channel independently of the others, so that further signals may be run as
    # further channels. Its state is then what they share, of `state_size(0)`, and rows of one number a
    # channel
    apart: bool = False
    several: bool = False  # whether it does something only where there are several chambers
    # whether it acts where no temperature is recorded, as at `REFERENCE_C`
    at_reference: bool = False
    linear: str = ""  # parameter in which what it adds to its signal is linear; empty where there is none

    def __post_init__(self):
        super().__post_init__()
        signals = SIGNALS[self.stage]
        if not self.signal:
            object.__setattr__(self, "signal", signals[0])
        if self.signal not in signals:
            raise InputError(
                f"Effect '{self.name}': signal '{self.signal}' must be one of {', '.join(signals)} "
                f"in stage '{self.stage}'."
            )

    @property
    def of_markers(self) -> bool:
        """Whether it acts on the tip, so that joint angles do not show it."""
        return self.signal in ("markers", "mount")

    @property
    def of_air(self) -> bool:
        """Whether it acts between the commanded and the measured pressure."""
        return self.stage == "pneumatics" and not self.of_gauge

    def apply(
        self,
        x: np.ndarray,
        dt: np.ndarray,
        values: dict[str, float] | None = None,
        conditions: np.ndarray | None = None,
        state: np.ndarray | None = None,
    ) -> np.ndarray:
        """Runs the effect on a copy of one signal, (n,) or (n, channels); for trying it out and for tests.

        Args:
            x: the signal.
            dt: (n,) seconds; the first is taken as infinite where `state` is not given.
            values: parameters; those left out take their default for a pressure range of max |x|.
            conditions: (n, k) in the order of `columns`.
            state: continues from there and is updated.
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
