"""What the material adds by memory and rate.

Heat, moisture and wear of the material.
"""

import math
from functools import partial

import numpy as np
from numba import njit
from scipy.signal import fftconvolve

from pneutac_truths.effects.air import lag
from pneutac_truths.effects.table import by_column, effect
from pneutac_truths.programs import DT_S
from pneutac_truths.world import World, seconds

acts = partial(effect, "material")


def share_of(w: World) -> np.ndarray:
    """Driven bend (n, c) as share of the top bend."""
    return w.drive / w.body.bend_rad


def softer(w: World, by: np.ndarray) -> None:
    """More compliant by the factor `by` (n,) against both air and load."""
    w.drive = w.drive * by[:, None]
    w.softer = w.softer * by


@acts(order=(0.12, 0.45), size=(0.003, 0.15))
def creep_fractional(w: World, order: float, size: float) -> None:
    """Spring-pot creep: bend under held pressure grows with a power of time.

    `size`: bend added one second after a step, over the step. Source: Scott Blair, J. Colloid Sci. 2 (1947)
    21; Mainardi, Fractional Calculus and Waves (2010).
    """
    n = len(w.drive)
    grown = ((np.arange(n) + 0.5) * DT_S) ** order
    step = np.diff(w.drive, axis=0, prepend=0.0)
    w.memory = w.memory + size * fftconvolve(step, grown[:, None], axes=0)[:n]


@acts(relax_s=(1.0, 20.0), size=(0.02, 0.5))
def standard_solid(w: World, relax_s: float, size: float) -> None:
    """One slow relaxation (standard linear solid).

    `size`: bend gained in the end over the bend at once. Source: Zener, Elasticity and Anelasticity of Metals
    (1948); Christensen, Theory of Viscoelasticity (1982).
    """
    w.memory = w.memory + size * lag(w.drive, relax_s)


@acts(width=(0.1, 0.35), size=(0.02, 1.2))
def hysteresis_preisach(w: World, width: float, size: float) -> None:
    """Hysteresis of a distribution of relays between loading and unloading.

    `size`: weight of the relays; `width`: scale of the distribution of their half widths. Source: Preisach,
    Z. Phys. 94 (1935) 277; Mayergoyz, Mathematical Models of Hysteresis (2003).
    """
    x = share_of(w)
    relays = _relays(np.ascontiguousarray(x), *relay_plane(width))
    w.memory = w.memory + size * w.body.bend_rad * (relays - x)


def relay_plane(width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Thresholds up and down, shares of the top bend, and weights of the relays, three (780,)."""
    side = np.linspace(0.01, 0.99, 40)
    up, down = (a[np.triu_indices(40, 1)] for a in np.meshgrid(side, side))
    up, down = np.maximum(up, down), np.minimum(up, down)
    weight = np.exp(-(up - down) / (2 * width)) * np.exp(-((((up + down) / 2 - 0.45) / 0.4) ** 2))
    return up, down, weight / weight.sum()


@by_column
def _relays(x, out, up, down, weight):
    state = np.zeros(len(up))
    last, y = 0.0, 0.0
    for i in range(len(x)):
        v = x[i]
        if v > last:
            for k in range(len(up)):
                if state[k] == 0.0 and v > up[k]:
                    state[k] = 1.0
                    y += weight[k]
        elif v < last:
            for k in range(len(up)):
                if state[k] == 1.0 and v < down[k]:
                    state[k] = 0.0
                    y -= weight[k]
        last = v
        out[i] = y


@acts(strength=(0.8, 2.0), size=(0.01, 0.3))
def friction_maxwell(w: World, strength: float, size: float) -> None:
    """Dry friction of many small elements that stick, stretch and slip one after the other.

    `size`: total slip moment over the moment of the top pressure; slip forces spread as a Weibull law.
    Source: Iwan, J. Appl. Mech. 33 (1966) 893; Al-Bender, Lampaert and Swevers, IEEE T. Autom. Control 50
    (2005).
    """
    n = 48
    slip = (-np.log(1 - (np.arange(n) + 0.5) / n)) ** (1 / strength)
    slip *= size / slip.sum()
    x = share_of(w)
    w.memory = w.memory + w.body.bend_rad * (_slipping(x, slip, 12.0 * size / n) - x)


@by_column
def _slipping(moment, out, slip, stiffness):
    """Bend (n, c) at which body and elements of friction together balance the moment."""
    n = len(slip)
    force, bend = np.zeros(n), 0.0
    for i in range(len(moment)):
        x = bend
        for _ in range(20):  # Newton on a rising, piecewise linear sum
            total, slope = x, 1.0
            for k in range(n):
                f = force[k] + stiffness * (x - bend)
                if abs(f) < slip[k]:
                    slope += stiffness
                total += min(max(f, -slip[k]), slip[k])
            step = (moment[i] - total) / slope
            x += step
            if abs(step) < 1e-10:
                break
        for k in range(n):
            force[k] = min(max(force[k] + stiffness * (x - bend), -slip[k]), slip[k])
        bend = x
        out[i] = bend


@acts(overstress=(0.05, 0.4), size=(0.02, 4.0))
def rate_stiffening(w: World, overstress: float, size: float) -> None:
    """The faster it is strained, the stiffer it is: flow by thermally activated jumps.

    `size`: time constant of slow motion, s; faster above the share `overstress` of the top moment. Source:
    Eyring, J. Chem. Phys. 4 (1936) 283; Bergström and Boyce, J. Mech. Phys. Solids 46 (1998) 931.
    """
    w.drive = w.body.bend_rad * _eyring(share_of(w), size, overstress)


@by_column
def _eyring(m, out, tau, sigma):
    parts = 4
    x = m[0]
    for i in range(len(m)):
        for _ in range(parts):
            miss = m[i] - x
            step = DT_S / parts / tau * sigma * math.sinh(min(max(miss / sigma, -8.0), 8.0))
            x += step if abs(step) < abs(miss) else miss
        out[i] = x


@acts(forget_s=(20.0, 200.0), round=(0.1, 0.3), size=(0.02, 0.8))
def mullins(w: World, forget_s: float, round: float, size: float) -> None:
    """Strained beyond what it knew, the silicone is stiffer; what it knew it forgets at rest (Mullins).

    `size`: bend gained well below the greatest one known. Source: Mullins, Rubber Chem. Technol. 42 (1969)
    339; Ogden and Roxburgh, Proc. R. Soc. A 455 (1999) 2861.
    """
    x = share_of(w)
    known = _known(x, math.exp(-DT_S / forget_s))
    w.drive = w.drive * (1 + size * np.tanh((known - x) / round))


@by_column
def _known(x, out, keep):
    y = 0.0
    for i in range(len(x)):
        y = max(y * keep, x[i])
        out[i] = y


@acts(power=(2.0, 5.0), heal_s=(15.0, 120.0), size=(0.0005, 0.05))
def set_norton(w: World, power: float, heal_s: float, size: float) -> None:
    """High pressure leaves a set by power-law flow, which heals slowly.

    `size`: share of the top bend gained per second at the top pressure. Source: Norton, The Creep of Steel
    (1929); Findley, Lai and Onaran, Creep and Relaxation (1976).
    """
    x = np.clip(share_of(w), 0, None) ** power
    w.memory = w.memory + size * heal_s * w.body.bend_rad * lag(np.vstack([0 * x[:1], x[:-1]]), heal_s)


@acts(rest_s=(5.0, 60.0), stroke=(0.3, 1.5), size=(0.02, 0.6))
def filler_network(w: World, rest_s: float, stroke: float, size: float) -> None:
    """Motion breaks the filler's network, rest builds it again: softer when worked (thixotropy).

    `size`: compliance gained when all is broken; `stroke` breaks most of it. Source: Payne, J. Appl. Polym.
    Sci. 6 (1962) 57; Kraus, J. Appl. Polym. Sci. Symp. 39 (1984) 75.
    """
    moved = np.abs(np.diff(share_of(w), axis=0, prepend=0.0)).mean(1)
    softer(w, 1 + size * (1 - _network(moved, DT_S / rest_s, stroke)))


@njit(cache=True)
def _network(moved, rest, stroke):
    out = np.empty_like(moved)
    whole = 1.0
    for i in range(len(moved)):
        whole += rest * (1.0 - whole) - min(moved[i] / stroke, 0.5) * whole
        out[i] = whole
    return out


@acts(stretch=(0.35, 0.7), relax_s=(1.0, 15.0), size=(0.02, 0.4))
def stretched_relaxation(w: World, stretch: float, relax_s: float, size: float) -> None:
    """Bend goes on for a while after a change of pressure, by a tail of stretched exponential.

    `size`: bend gained in the end over the bend at once. Source: Kohlrausch (1854); Williams and Watts,
    Trans. Faraday Soc. 66 (1970) 80.
    """
    n = min(len(w.drive), seconds(600.0))
    grown = 1 - np.exp(-((np.arange(n) * DT_S / relax_s) ** stretch))
    grown = np.concatenate([grown, np.full(len(w.drive) - n, grown[-1])])
    step = np.diff(w.drive, axis=0, prepend=0.0)
    w.memory = w.memory + size * fftconvolve(step, grown[:, None], axes=0)[: len(w.drive)]


@acts(cool_s=(20.0, 90.0), size=(0.01, 0.8))
def self_heating(w: World, cool_s: float, size: float) -> None:
    """Work lost in cycles warms the silicone, which softens and cools slowly.

    `size`: compliance gained by ten full strokes in one cooling time. Source: Medalia, Rubber Chem. Technol.
    64 (1991) 481; Katunin, Polymers 11 (2019) (self-heating).
    """
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


@acts(size=(0.02, 0.6))
def temperature_drift(w: World, size: float) -> None:
    """Silicone softens as the room warms.

    `size`: compliance gained over 10 K. Logged in `temperature_c`. Source: Rey et al., Polymer Testing 32
    (2013) 492; Treloar, The Physics of Rubber Elasticity (1975).
    """
    w.temperature_c = room_temperature(w, "temperature")
    softer(w, 1 + size * (w.temperature_c - 22) / 10)


@acts(minutes=(1.5, 5.0), size=(0.02, 0.8))
def temperature_lag(w: World, minutes: float, size: float) -> None:
    """The silicone softens with its own temperature, which follows the room's minutes later.

    `size`: compliance gained over 10 K; the log has the air's temperature. Source: Incropera et al.,
    Fundamentals of Heat and Mass Transfer (2007) ch. 5 (lumped body); Rey et al. (2013).
    """
    w.temperature_c = room_temperature(w, "temperature")
    softer(w, 1 + size * (lag(w.temperature_c[:, None], 60 * minutes)[:, 0] - 22) / 10)


@acts(minutes=(2.0, 8.0), size=(0.01, 0.4))
def humidity_swelling(w: World, minutes: float, size: float) -> None:
    """One face of the body takes up moisture and swells, so the rest shape creeps away.

    `size`: bend in the end, rad; by the short-time law of diffusion, then to its limit. Source: Flory,
    Principles of Polymer Chemistry (1953) ch. 13; Crank, The Mathematics of Diffusion (1975) ch. 4.
    """
    s = w.time_s / (60 * minutes)
    w.memory = w.memory.copy()
    w.memory[:, 0] += size * np.tanh(np.sqrt(s))


@acts(strokes=(5.0, 40.0), size=(0.01, 0.5))
def fatigue(w: World, strokes: float, size: float) -> None:
    """Each stroke wears the body a little: compliance grows with the logarithm of strokes.

    `size`: compliance gained per factor e of strokes beyond `strokes`. Each session starts rested. Source:
    Mars and Fatemi, Int. J. Fatigue 24 (2002) 949.
    """
    done = np.cumsum(np.abs(np.diff(share_of(w), axis=0, prepend=0.0)).mean(1)) / 2
    softer(w, 1 + size * np.log1p(done / strokes))
