"""Effects of a camera-based touch sensor: on how its gel is pressed (`gel`) and on its light (`light`).

A photograph is made as follows; an effect has one hook or more of these and leaves the others out:

    press  -> (press) -> probe grid -> imprint -> surface u, on what earlier presses left (late) -> (surface)
    u      -> compiled light, bent by (coefficients) -> (light) -> s, a colour channel at a time
    image  =  (rest + (weight) s) (gain)

One pair of images does not identify everything about the light, so a fit holds each parameter to a prior
around its default as far as the images leave it free. A parameter whose name has `red`, `green` or `blue` in
it belongs to that channel; the others are one number for the sensor.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pneutac_sim.effects.effect import SENSOR_STAGES, Effect, Parameter
from pneutac_sim.errors import InputError

CHANNELS = ("red", "green", "blue")

HOOKS = {
    "gel": ("press", "late", "surface", "steps"),
    "light": ("lend", "coefficients", "light", "weight", "gain", "estimate"),
}

Values = dict[str, float]


def each_channel(
    name: str, unit: str, default: float, lower: float, upper: float, neutral: float = 0.0
) -> tuple[Parameter, ...]:
    """One parameter for each of red, green and blue, whose name takes the place of `{}`."""
    return tuple(Parameter(name.format(c), unit, default, lower, upper, neutral) for c in CHANNELS)


@dataclass(frozen=True)
class Quiet:
    """A photograph where nothing touches, m cells of the probe grid."""

    clock: float  # when in the session, 0 to 1
    rest: np.ndarray  # (m, 3) levels without contact
    image: np.ndarray  # (m, 3) levels in the photograph


@dataclass(frozen=True, kw_only=True)
class SensorEffect(Effect):
    """One mechanism of a touch sensor.

    Hooks of the stage `light` take the values `v` of one channel, named without the channel (`distance_mm`
    for `distance_red_mm`); the others take all values by their names.
    """

    stages = SENSOR_STAGES

    prior_sd: tuple[float, ...]  # standard deviation of the prior of each parameter around its default
    # belongs to every sensor, so that it is fitted to one whose light nobody has looked at yet
    standard: bool = False
    # belongs to how the photographs were taken rather than to the sensor, so that one pair of images cannot
    # show it
    of_session: bool = False
    # (make, channel number) -> name without the channel to (mean, standard deviation), what sensors of one
    # make share; see `gel.layout.Layout`
    lend: Callable[[Any, int], dict[str, tuple[float, float]]] | None = None
    # (press, values) -> where and how it truly presses; see `gel.indenter.Press`
    press: Callable[[Any, Values], Any] | None = None
    # (values) -> (share, time in s) of each branch by which a surface that was held comes back late, see
    # `gel.sensor`
    late: Callable[[Values], Sequence[tuple[float, float]]] | None = None
    # (u, cell_mm, values) -> changed displacement (rows, columns), mm into the gel
    surface: Callable[[np.ndarray, tuple[float, float], Values], np.ndarray] | None = None
    # farthest press from the centre in mm -> (p,) by which a fit moves the parameters of an effect of the
    # stage `gel` to see what the images do; None for a thousandth of each range
    steps: Callable[[float], Sequence[float]] | None = None
    # (row, towards, v) writes into one channel's row of the compiled light, see `gel.optics`; `towards` (2,)
    # is the unit vector from the window's centre to the light
    coefficients: Callable[[np.ndarray, np.ndarray, Values], None] | None = None
    # (s, u, cell_mm, v) -> changed light (rows, columns) of one channel in levels, zero where u is
    light: Callable[[np.ndarray, np.ndarray, tuple[float, float], Values], np.ndarray] | None = None
    # (log_rest, v) -> factor on one channel's light at pixels whose rest image is exp(log_rest) times its
    # mean
    weight: Callable[[np.ndarray, Values], np.ndarray] | None = None
    # (clock, values) -> (3,) factors on the whole picture at a time of the session
    gain: Callable[[float, Values], np.ndarray] | None = None
    # (quiet parts of the photographs) -> values of an effect that has a gain
    estimate: Callable[[Sequence[Quiet]], Values] | None = None

    def __post_init__(self):
        super().__post_init__()
        if len(self.prior_sd) != len(self.parameters) or not all(sd > 0 for sd in self.prior_sd):
            raise InputError(
                f"Effect '{self.name}': prior_sd must be {len(self.parameters)} positive numbers, one for "
                "each parameter."
            )
        if (self.gain is None) != (self.estimate is None):
            raise InputError(f"Effect '{self.name}': gain and estimate come together.")
        for stage, hooks in HOOKS.items():
            for hook in hooks if stage != self.stage else ():
                if getattr(self, hook) is not None:
                    raise InputError(f"Effect '{self.name}': stage '{self.stage}' has no hook '{hook}'.")

    @property
    def of_channels(self) -> bool:
        """Whether it is fitted with the light of each channel."""
        return self.stage == "light" and self.gain is None

    def of_channel(self, k: int) -> Iterator[tuple[str, Parameter, float]]:
        """Name without the channel, parameter and its prior's deviation, of all that channel k reads."""
        for p, sd in zip(self.parameters, self.prior_sd, strict=True):
            words = p.name.split("_")
            channel = next((c for c in CHANNELS if c in words), None)
            if channel in (None, CHANNELS[k]):
                yield "_".join(w for w in words if w != channel), p, sd

    def channel_values(self, values: Values, k: int) -> Values:
        """The values that channel k reads, named without the channel."""
        return {name: values[p.name] for name, p, _ in self.of_channel(k)}

    def inside(self, values: Values) -> Values:
        """These values, moved to the nearest bound where they lie beyond."""
        return {p.name: min(max(values[p.name], p.lower), p.upper) for p in self.parameters}

    def describe(self, values: Values, device: str = "gel") -> str:
        """The summary with numbers, e.g. of a fit."""
        return super().describe(values, device)
