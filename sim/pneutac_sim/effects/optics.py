"""Optics effects of a camera-based touch sensor; `gel.optics` and `gel.model` hold what they do.

Each has parameters, bounds and a prior like the finger's effects, but acts on images: `prior_sd` is how far a
parameter may plausibly lie from its default. One pair of images cannot tell everything about the light, so a
fit is held to the priors as far as the images leave it free.
"""

from dataclasses import dataclass

from pneutac_sim.effects.effect import Parameter
from pneutac_sim.twin import Value

CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True)
class OpticsEffect:
    """One optical mechanism.

    Attributes:
        name: as the user types it.
        parameters: one for each of red, green and blue where its name says so.
        prior_sd: standard deviation of the prior of each parameter around its default.
        summary: one sentence for a newcomer, with `{device}` and `{parameter}` placeholders.
        experiment: what to record to see the effect apart from its rivals.
    """

    name: str
    parameters: tuple[Parameter, ...]
    prior_sd: tuple[float, ...]
    summary: str
    experiment: str
    stage: str = "optics"

    def start(self, pressure_range_kpa: float = 1.0) -> dict[str, Value]:
        """Parameter values with which a fit starts; optics know no pressure."""
        return {p.name: Value(p.default) for p in self.parameters}

    def describe(self, values: dict[str, float], device: str = "gel") -> str:
        """The summary with numbers, e.g. of a fit."""
        return self.summary.format(device=device, **values)


def _each(name: str, unit: str, default: float, lower: float, upper: float, neutral: float = 0.0):
    return tuple(Parameter(name.format(c), unit, default, lower, upper, neutral) for c in CHANNELS)


# Levels for a slope of one along the light, across it, and for a millimetre of depth, all squared.
QUADRATIC = ("along_{}_levels", "across_{}_levels", "deep_{}_levels")

REST_COLOUR = OpticsEffect(
    "rest_colour",
    _each("exponent_{}", "", 0.7, -1.0, 4.0),
    (0.1,) * 3,
    "The light of your {device} is stronger where its rest image is brighter: it goes with the rest colour "
    "to the power {exponent_red:.2g} (red), {exponent_green:.2g} (green), {exponent_blue:.2g} (blue).",
    "Press the same ball to the same depth at a bright and at a dark place of the rest image.",
)
NEAR_LIGHT = OpticsEffect(
    "near_light",
    _each("distance_{}_mm", "mm", 200.0, 8.0, 1000.0),
    (100.0,) * 3,
    "The lights of your {device} are near: {distance_red_mm:.3g} mm (red), {distance_green_mm:.3g} mm "
    "(green) and {distance_blue_mm:.3g} mm (blue) from the window's centre, so their direction turns over "
    "the image.",
    "Press the same ball to the same depth near all four edges.",
)
PHOTOMETRIC_NONLINEARITY = OpticsEffect(
    "photometric_nonlinearity",
    _each("direct_{}_levels", "levels", 60.0, 3.0, 400.0)
    + tuple(p for name in QUADRATIC for p in _each(name, "levels", 0.0, -400.0, 400.0)),
    (40.0,) * 3 + (30.0,) * 9,
    "The light of your {device} follows Lambert's cosine, not the slope: sides that face away go dark and no "
    "darker, by {direct_red_levels:.3g}, {direct_green_levels:.3g} and {direct_blue_levels:.3g} levels.",
    "Press balls of several radii to several depths at one place.",
)
SHADOW = OpticsEffect(
    "shadow",
    _each("shadow_{}_levels", "levels", 40.0, 0.0, 400.0)
    + _each("elevation_{}", "", 0.25, 0.03, 1.0)
    + (Parameter("edge_mm", "mm", 0.1, 0.02, 0.6),),
    (40.0,) * 3 + (0.08,) * 3 + (0.08,),
    "Imprints cast shadows in your {device}: {shadow_red_levels:.3g}, {shadow_green_levels:.3g} and "
    "{shadow_blue_levels:.3g} levels are missing behind them; the lights stand at slopes of "
    "{elevation_red:.2g}, {elevation_green:.2g} and {elevation_blue:.2g} over the gel.",
    "Press a ball deep in the middle and look for dark tails beyond the contact, away from each light.",
)
ILLUMINATION_DRIFT = OpticsEffect(
    "illumination_drift",
    _each("gain_{}", "", 1.0, 0.5, 2.0, 1.0) + _each("drift_{}", "1/session", 0.0, -0.5, 0.5),
    (0.03,) * 3 + (0.05,) * 3,
    "The light or exposure of your {device} drifts: against the rest image it begins at {gain_red:.3f}, "
    "{gain_green:.3f} and {gain_blue:.3f} times and changes by {drift_red:+.1%}, {drift_green:+.1%} and "
    "{drift_blue:+.1%} over the session.",
    "Take a rest image before each press and name it in a column 'rest_image'; fix exposure and whites.",
)
REGISTRATION_SHIFT = OpticsEffect(
    "registration_shift",
    (
        Parameter("shift_x_mm", "mm", 0.0, -3.0, 3.0),
        Parameter("shift_y_mm", "mm", 0.0, -3.0, 3.0),
        Parameter("turn_rad", "rad", 0.0, -0.3, 0.3),
        Parameter("scale", "", 1.0, 0.7, 1.4, 1.0),
    ),
    (0.5, 0.5, 0.05, 0.05),
    "The contacts of your {device} lie {shift_x_mm:+.2f} mm (x) and {shift_y_mm:+.2f} mm (y) beside where "
    "the recording says, turned by {turn_rad:+.3f} rad and {scale:.3f} times as far from the centre.",
    "Press a small ball at the four corners and in the middle, and measure where the images show it.",
)

# In the order in which they act on an image.
OPTICS = {
    e.name: e
    for e in (
        REGISTRATION_SHIFT,
        NEAR_LIGHT,
        PHOTOMETRIC_NONLINEARITY,
        SHADOW,
        REST_COLOUR,
        ILLUMINATION_DRIFT,
    )
}
# What a sensor has whose light nobody has looked at yet: the sensor itself, not how it was photographed.
SENSOR = ("near_light", "photometric_nonlinearity", "shadow", "rest_colour")
