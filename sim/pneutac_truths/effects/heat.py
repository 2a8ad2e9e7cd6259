"""Heat, moisture and wear of the material."""

import numpy as np

from pneutac_truths.effects.air import lag
from pneutac_truths.effects.material import share_of, softer
from pneutac_truths.effects.table import effect
from pneutac_truths.programs import DT_S
from pneutac_truths.world import World


@effect(
    "material",
    "Work lost in cycles warms the silicone, which softens and cools slowly.",
    "Medalia, Rubber Chem. Technol. 64 (1991) 481; Katunin, Polymers 11 (2019) (self-heating)",
    cool_s=(20.0, 90.0),
    size=(0.01, 0.8),
)
def self_heating(w: World, cool_s: float, size: float) -> None:
    """`size`: compliance gained by ten full strokes in one cooling time."""
    work = np.abs(np.diff(share_of(w) ** 2, axis=0, prepend=0.0)).sum(1, keepdims=True) / 20
    heat = lag(work * cool_s / DT_S, cool_s)[:, 0]
    softer(w, 1 + size * heat)


def room_temperature(w: World, name: str) -> np.ndarray:
    """Air temperature (n,) in C: a ramp and a slow wander, as in a lab with heating and doors.

    Where the plan has a temperature of each trial, it wanders by a little about that.
    """
    rng, t = w.draws(name), w.time_s / w.time_s[-1]
    if "temperature_c" in w.plan.conditions:
        turn = 2 * np.pi * (rng.uniform(1, 2.5) * t + rng.uniform())
        return w.plan.conditions["temperature_c"][w.plan.trial] + 0.2 * np.sin(turn)
    ramp = rng.choice([-1, 1]) * rng.uniform(5, 9)
    phase = rng.uniform(0, 2 * np.pi)
    return 22 + ramp * (t - 0.5) + 1.2 * np.sin(2 * np.pi * rng.uniform(1, 2.5) * t + phase)


@effect(
    "material",
    "Silicone softens as the room warms.",
    "Rey et al., Polymer Testing 32 (2013) 492; Treloar, The Physics of Rubber Elasticity (1975)",
    size=(0.02, 0.6),
)
def temperature_drift(w: World, size: float) -> None:
    """`size`: compliance gained over 10 K. Logged in `temperature_c`."""
    w.temperature_c = room_temperature(w, "temperature")
    softer(w, 1 + size * (w.temperature_c - 22) / 10)


@effect(
    "material",
    "The silicone softens with its own temperature, which follows the room's minutes later.",
    "Incropera et al., Fundamentals of Heat and Mass Transfer (2007) ch. 5 (lumped body); Rey et al. (2013)",
    minutes=(1.5, 5.0),
    size=(0.02, 0.8),
)
def temperature_lag(w: World, minutes: float, size: float) -> None:
    """`size`: compliance gained over 10 K; the log has the air's temperature."""
    w.temperature_c = room_temperature(w, "temperature")
    softer(w, 1 + size * (lag(w.temperature_c[:, None], 60 * minutes)[:, 0] - 22) / 10)


@effect(
    "material",
    "One face of the body takes up moisture and swells, so the rest shape creeps away.",
    "Flory, Principles of Polymer Chemistry (1953) ch. 13; Crank, The Mathematics of Diffusion (1975) ch. 4",
    minutes=(2.0, 8.0),
    size=(0.01, 0.4),
)
def humidity_swelling(w: World, minutes: float, size: float) -> None:
    """`size`: bend in the end, rad; by the short-time law of diffusion, then to its limit."""
    s = w.time_s / (60 * minutes)
    w.memory = w.memory.copy()
    w.memory[:, 0] += size * np.tanh(np.sqrt(s))


@effect(
    "material",
    "Each stroke wears the body a little: compliance grows with the logarithm of strokes.",
    "Mars and Fatemi, Int. J. Fatigue 24 (2002) 949",
    strokes=(5.0, 40.0),
    size=(0.01, 0.5),
)
def fatigue(w: World, strokes: float, size: float) -> None:
    """`size`: compliance gained per factor e of strokes beyond `strokes`. Each session starts rested."""
    done = np.cumsum(np.abs(np.diff(share_of(w), axis=0, prepend=0.0)).mean(1)) / 2
    softer(w, 1 + size * np.log1p(done / strokes))
