"""Laws: effects that are composed of an input, a memory, a role and a condition, one entry each.

A law acts on the pressure that bends a body (stage `drive`) by adding a term to it,

    p -> p + w c g,   g = M[f(p)]  (added)   or   g = p M[f(p)] / P  (a gain),

on where its tip is (stage `material`), or on what is read of it (stage `observation`). f is the input, M the
memory, c the condition, P the largest pressure. A twin keeps a law as its name and its constants, so a found
law is data and nothing that came with a twin is executed.

Sources of the memories: first-order lags; a power-law spectrum of them (a spring-pot: Nutting, J. Franklin
Inst. 191, 1921); second order; play and Bouc-Wen loops (Macki, Nistri, Zecca, SIAM Review 35, 1993); a
maximum that fades (Mullins: Diani, Fayolle, Gilormini, Eur. Polym. J. 45, 2009; its tanh: Dorfmann, Ogden,
Int. J. Solids Struct. 41, 2004); damage under load (Kachanov, 1958); path travelled; loss while held.
"""

# ruff: noqa: D103 - inputs and memories are what the equations in the catalogue say

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numba import njit

from pneutac_sim.effects import air_resonance, gain_saturation, hysteresis, stiffening
from pneutac_sim.effects.air_resonance import second_order
from pneutac_sim.effects.body_effect import REFERENCE_C, BodyEffect, kernel
from pneutac_sim.effects.effect import Parameter, plain_equation

SLOTS = (
    16  # numbers that a channel remembers: whether it has begun, its pressure before, the memory's, its input
)
TIMES_S = np.geomspace(0.1, 400.0, 12)  # of the power-law spectrum

# ---------------------------------------------------------------- inputs f of the pressure x (n, channels)
# Arguments: x; dt (n,) s, infinite after a rest; before (channels,), the pressure before; c (n,), the counted
# condition; P.


def pressure(x, dt, before, c, P):
    return x


def squared(x, dt, before, c, P):
    return x * np.abs(x) / P


def condition(x, dt, before, c, P):
    return np.repeat(P * c[:, None], x.shape[1], axis=1)


@kernel
def rate(x, dt, before, c, P):
    """kPa/s since the sample before; zero after a rest."""
    out = np.empty_like(x)
    for t in range(len(x)):
        for i in range(x.shape[1]):
            last = x[t - 1, i] if t > 0 else before[i]
            out[t, i] = 0.0 if math.isinf(dt[t]) else (x[t, i] - last) / dt[t]
    return out


def speed(x, dt, before, c, P):
    return np.abs(rate(x, dt, before, c, P))


def work(x, dt, before, c, P):
    return np.abs(x * rate(x, dt, before, c, P)) / P


def others(x, dt, before, c, P):
    """The sum of the other chambers' pressures."""
    return x.sum(axis=1).reshape(-1, 1) - x


def drawn(x, dt, before, c, P):
    """Air that all chambers draw from their common supply, as a rate of their pressures."""
    total = np.maximum(rate(x, dt, before, c, P), 0.0).sum(axis=1)
    return np.repeat(total, x.shape[1]).reshape(x.shape)


SHARED = (others, drawn)  # they need several chambers, which they weaken
OF_RATE = (rate, speed, work, drawn)  # they hold since the sample before, where others are straight lines

# ---------------------------------------------------------------- steps of memories
# Arguments: s (slots, channels), what is remembered, changed; f (n + 1, channels), the one before first;
# dt (n,) s. Result: (n, channels).


@kernel
def lag_weights(h):
    """Weights of the state and of the input before, after h time constants."""
    keep = math.exp(-h)
    return keep, 0.0 if math.isinf(h) else (1.0 - keep) / h - keep if h > 1e-6 else 0.5 * h


@kernel
def _lag(s, f, late, dt, tau):
    """Exact steps of tau s' = f - s, row 2 of s, for tau (1 or n, 1 or channels) s.

    `late` is 0 where f is a straight line between samples, 1 where it holds since the sample before.
    """
    out = np.empty((len(f) - 1, f.shape[1]))
    known, keep, old = -1.0, 0.0, 0.0
    rows, columns = tau.shape
    for t in range(len(out)):
        for i in range(out.shape[1]):
            if i < columns:
                h = dt[t] / tau[t % rows, i]
                if h != known:  # most samples follow each other after the same time
                    known = h
                    keep, old = lag_weights(h)
            s[2, i] = keep * s[2, i] + old * f[t + late, i] + (1.0 - keep - old) * f[t + 1, i]
            out[t, i] = s[2, i]
    return out


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _spectrum(s, f, dt, exponent):
    """Lags side by side, from row 2 of s, weighted by a power of their times; a vector of them at once."""
    n = len(TIMES_S)
    out = np.empty((len(f) - 1, f.shape[1]))
    weight = TIMES_S**exponent
    weight /= weight.sum()
    keep, old, new, y = np.zeros(n), np.zeros(n), np.zeros(n), np.empty((out.shape[1], n))
    for i in range(out.shape[1]):
        for j in range(n):
            y[i, j] = s[2 + j, i]
    known = -1.0
    for t in range(len(out)):
        if dt[t] != known:
            known = dt[t]
            for j in range(n):
                keep[j], old[j] = lag_weights(known / TIMES_S[j])
                new[j] = 1.0 - keep[j] - old[j]
        for i in range(out.shape[1]):
            before, now, total = f[t, i], f[t + 1, i], 0.0
            for j in range(n):
                y[i, j] = keep[j] * y[i, j] + old[j] * before + new[j] * now
                total += weight[j] * y[i, j]
            out[t, i] = total
    for i in range(out.shape[1]):
        for j in range(n):
            s[2 + j, i] = y[i, j]
    return out


@kernel
def fill_vent_lag(s, f, dt, times):
    """A lag with one time on the way up and another on the way down."""
    out = np.empty((len(f) - 1, f.shape[1]))
    known, keeps, olds = -1.0, np.zeros(2), np.zeros(2)
    for t in range(len(out)):
        if dt[t] != known:
            known = dt[t]
            for j in range(2):
                keeps[j], olds[j] = lag_weights(known / times[j])
        for i in range(out.shape[1]):
            way = 0 if f[t + 1, i] > s[2, i] else 1
            keep, old = keeps[way], olds[way]
            s[2, i] = keep * s[2, i] + old * f[t, i] + (1.0 - keep - old) * f[t + 1, i]
            out[t, i] = s[2, i]
    return out


@kernel
def _play(s, f, dt, down, up):
    out = np.empty((len(f) - 1, f.shape[1]))
    for t in range(len(out)):
        for i in range(out.shape[1]):
            s[2, i] = min(max(s[2, i], f[t + 1, i] - down), f[t + 1, i] + up)
            out[t, i] = s[2, i]
    return out


@kernel
def _dead_band(s, f, dt, width):
    out = np.empty((len(f) - 1, f.shape[1]))
    for t in range(len(out)):
        for i in range(out.shape[1]):
            if math.isinf(dt[t]) or abs(f[t + 1, i] - s[2, i]) > width:
                s[2, i] = f[t + 1, i]
            out[t, i] = s[2, i]
    return out


_APART = 1 / 256  # of a width, between two numbers of the curve


@cache
def _virgin_curve() -> np.ndarray:
    """(n,) z of a loop of width 1 that goes up from z = -1: dz/df = 1 - |z|^0.3 z, by Runge and Kutta."""

    def slope(z: float) -> float:
        return 1.0 - abs(z) ** 0.3 * z

    z, h, out = -1.0, _APART, []
    while 1.0 - z > 1e-9:
        out.append(z)
        a = slope(z)
        b = slope(z + h / 2 * a)
        c = slope(z + h / 2 * b)
        z += h / 6 * (a + 2 * b + 2 * c + slope(z + h * c))
    return np.array([*out, 1.0])


@kernel
def _bouc_wen(s, f, dt, width, curve):
    """Without stiffness: z' = (f' - |f'| |z|^0.3 z) / width.

    Where f goes one way, z follows one curve, see `_virgin_curve`: from its place there it goes on by |df|.
    """
    out = np.empty((len(f) - 1, f.shape[1]))
    last = len(curve) - 1
    near = np.full(out.shape[1], last)  # where z ended, and mostly begins again
    for t in range(len(out)):
        for i in range(out.shape[1]):
            d = (f[t + 1, i] - f[t, i]) / width
            if d != 0.0:
                way = math.copysign(1.0, d)
                z = way * s[2, i]
                k = near[i]
                if not curve[k - 1] < z <= curve[k]:
                    k = min(max(np.searchsorted(curve, z), 1), last)
                at = k - 1 + (z - curve[k - 1]) / (curve[k] - curve[k - 1]) + abs(d) / _APART
                if at >= last:
                    near[i], z = last, 1.0
                else:
                    k = int(at) if at > 0.0 else 0  # also where it is not finite
                    near[i], z = k + 1, curve[k] + (at - k) * (curve[k + 1] - curve[k])
                s[2, i] = way * z
            out[t, i] = width * s[2, i]
    return out


@kernel
def _fading_max(s, f, dt, tau):
    out = np.empty((len(f) - 1, f.shape[1]))
    for t in range(len(out)):
        keep = math.exp(-dt[t] / tau)
        for i in range(out.shape[1]):
            s[2, i] = max(s[2, i] * keep, f[t + 1, i])
            out[t, i] = s[2, i]
    return out


@kernel
def _below_max(s, f, dt, least):
    """1 - f / (its largest so far)."""
    out = np.empty((len(f) - 1, f.shape[1]))
    for t in range(len(out)):
        for i in range(out.shape[1]):
            s[2, i] = max(s[2, i], f[t + 1, i], least)
            out[t, i] = 1.0 - max(f[t + 1, i], 0.0) / s[2, i]
    return out


@kernel
def _path(s, f, dt, half):
    """Share n / (n + half) of the path n travelled."""
    out = np.empty((len(f) - 1, f.shape[1]))
    for t in range(len(out)):
        for i in range(out.shape[1]):
            s[2, i] += abs(f[t + 1, i] - f[t, i])
            out[t, i] = 1.0 - 1.0 / (1.0 + s[2, i] / half)
    return out


@kernel
def _damage(s, f, dt, tau, power):
    """1 - exp(-D), D' = f^power / tau of a share f of the range (Kachanov's damage under load)."""
    out = np.empty((len(f) - 1, f.shape[1]))
    for t in range(len(out)):
        for i in range(out.shape[1]):
            if not math.isinf(dt[t]):
                # the latter pressure alone: a pause between trials begins under pressure and is spent without
                s[2, i] += dt[t] * max(f[t + 1, i], 0.0) ** power / tau
            out[t, i] = 1.0 - math.exp(-s[2, i])
    return out


@kernel
def _loss_while_held(s, f, dt, k, still):
    out = np.empty((len(f) - 1, f.shape[1]))
    for t in range(len(out)):
        keep = math.exp(-dt[t] * k)
        for i in range(out.shape[1]):
            moved = math.isinf(dt[t]) or abs(f[t + 1, i] - f[t, i]) > still
            s[2, i] = 0.0 if moved else s[2, i] * keep - f[t + 1, i] * (1.0 - keep)
            out[t, i] = s[2, i]
    return out


# ---------------------------------------------------------------- memories M[f]
# Arguments: f (n + 1, channels), the one before first; dt (n,) s; k, constants; s (slots, channels), what is
# remembered; P; x (n, channels), the pressure; c (n,), the counted condition; late, see `_lag`.
# Result: (n, channels).


def none(f, dt, k, s, P, x, c, late):
    return f[1:]


def cube(f, dt, k, s, P, x, c, late):
    return f[1:] ** 3 / P**2


def power(f, dt, k, s, P, x, c, late):
    return np.copysign(P * np.abs(f[1:] / P) ** k[0], f[1:])


def tanh(f, dt, k, s, P, x, c, late):
    return P * np.tanh(k[0] * f[1:] / P) / k[0]


def hinge(f, dt, k, s, P, x, c, late):
    return np.maximum(f[1:] - k[0], 0.0)


def step(f, dt, k, s, P, x, c, late):
    return P * np.tanh((f[1:] - k[0]) / k[1])


def play(f, dt, k, s, P, x, c, late):
    return _play(s, f, dt, k[0], k[0])


def play_two(f, dt, k, s, P, x, c, late):
    return _play(s, f, dt, k[0], k[1])


def play_cubed(f, dt, k, s, P, x, c, late):
    return _play(s, f, dt, k[0], k[0]) ** 3 / P**2


def flip(f, dt, k, s, P, x, c, late):
    return P * np.tanh((_play(s, f, dt, k[0], k[0]) - k[1]) / k[2])


def dead_band(f, dt, k, s, P, x, c, late):
    return _dead_band(s, f, dt, k[0])


def rounded(f, dt, k, s, P, x, c, late):
    return k[0] * np.round(f[1:] / k[0])


def loop(f, dt, k, s, P, x, c, late):
    return _bouc_wen(s, f, dt, k[0], _virgin_curve())


def lag(f, dt, k, s, P, x, c, late):
    return _lag(s, f, late, dt, k[:1, None])


def lag_warm(f, dt, k, s, P, x, c, late):
    return _lag(s, f, late, dt, (k[0] * k[1] ** c)[:, None])


def lag_pressure(f, dt, k, s, P, x, c, late):
    return _lag(s, f, late, dt, k[0] * k[1] ** (x / P))


def tanh_of_lag(f, dt, k, s, P, x, c, late):
    return P * np.tanh(_lag(s, f, late, dt, k[1:2, None]) / k[0])


def root_of_lag(f, dt, k, s, P, x, c, late):
    return P * np.sqrt(np.abs(_lag(s, f, late, dt, k[:1, None])) / P)


def spectrum(f, dt, k, s, P, x, c, late):
    return _spectrum(s, f, dt, k[0])


def fill_vent(f, dt, k, s, P, x, c, late):
    return fill_vent_lag(s, f, dt, k)


def mode(f, dt, k, s, P, x, c, late):
    return second_order(s, f, dt, k[0], k[1])


def held(f, dt, k, s, P, x, c, late):
    return _loss_while_held(s, f, dt, k[0], 1e-6 * P)


def fading_max(f, dt, k, s, P, x, c, late):
    return _fading_max(s, f, dt, k[0])


def below_fading_max(f, dt, k, s, P, x, c, late):
    return P * np.tanh((_fading_max(s, f, dt, k[0]) - x) / k[1])


def below_max(f, dt, k, s, P, x, c, late):
    return P * _below_max(s, f, dt, 1e-9) ** k[0]


def damage(f, dt, k, s, P, x, c, late):
    return P * _damage(s, f / P, dt, k[0], k[1])


def path(f, dt, k, s, P, x, c, late):
    return P * _path(s, f, dt, k[0])


def fading_time(f, dt, k, s, P, x, c, late):
    return np.repeat(P * np.exp(-c / k[0])[:, None], x.shape[1], axis=1)


# ---------------------------------------------------------------- how laws run


def run_drive(x, dt, theta, conditions, state, *, input, memory, late, gain, minus, scaled, counted):
    """A law of the drive: p becomes p + w c (M[f] - minus f), the term times p / P for a gain.

    The first five arguments are those of any effect, with theta = weight, P and the memory's constants, and a
    row of the state a slot; the others are `Law.choices`: `late` is 1 where the input holds since the sample
    before, `counted` zero and unit of the condition, empty where there is none.
    """
    weight, P, k, s = theta[0], theta[1], theta[2:], state.reshape(SLOTS, x.shape[1])
    c = (conditions[:, 0] - counted[0]) / counted[1] if counted else np.empty(0)
    fresh = s[0, 0] == 0.0
    if fresh:
        dt = dt.copy()
        dt[0] = math.inf
    now = input(x, dt, s[1], c, P)
    f = np.concatenate((now[:1] if fresh else s[-1:], now))
    s[0], s[1], s[-1] = 1.0, x[-1], f[-1]
    g = memory(f, dt, k, s, P, x, c, late)  # f is used up from here on: all in place
    if minus:
        g -= f[1:]
    if scaled:
        g *= c[:, None]
    if gain:
        g *= x
        g /= P
    g *= weight
    x += g


def run_seen(x, dt, theta, conditions, state, *, out, feature, counted):
    """Output `out` gains theta[0] times a feature; conditions = length_mm and the feature's columns.

    `counted` has zero and unit of each column; the feature gets their product.
    """
    length = conditions[:, 0] if out < 3 else 1.0
    c = np.prod([(conditions[:, k] - zero) / unit for k, (zero, unit) in enumerate(counted, 1)], axis=0)
    x[:, out] += theta[0] * length * feature(x, length, c)


def run_tracker(x, dt, theta, conditions, state):
    """A camera or tracker that filters: all markers lag; theta = time.

    State, a row each: nothing, the markers before, the lagged ones.
    """
    s = state.reshape(3, x.shape[1])
    f = np.vstack([s[1:2], x])
    x[:] = _lag(s, f, 0, dt, theta[:1, None])
    s[1] = f[-1]


# ---------------------------------------------------------------- words

# Family to what such physics does to a device, and what it is called in a list of causes.
FAMILIES = {
    "stiffening": ("does not bend in proportion to the pressure", "a gain that changes with pressure"),
    "gain_saturation": ("saturates (each further kPa bends it less)", "saturation"),
    "contact": (
        "bends differently above a pressure, as if it met something",
        "another gain above a pressure",
    ),
    "hysteresis": (
        "has hysteresis (at one pressure it bends differently on the way up and on the way down)",
        "hysteresis",
    ),
    "snap": ("snaps over at a pressure and back at a lower one", "snap-through"),
    "creep": ("creeps (it goes on bending while the pressure is held)", "creep"),
    "relaxation": (
        "falls back while the pressure is held, after it went too far at a step",
        "a bend that falls back while the pressure is held",
    ),
    "overshoot": ("overshoots at a step and falls back at once", "overshoot at a step"),
    "valve_lag": ("fills and vents slower than it is commanded", "a slow valve"),
    "ringing": ("rings (it swings on after a step)", "oscillation after a step"),
    "leak": ("loses pressure while it is held", "loss of pressure during holds"),
    "friction": ("is held back by friction", "friction"),
    "rate": ("bends less or more the faster it moves", "dependence on the rate"),
    "cyclic_softening": (
        "is softer or stiffer after high pressures or many cycles",
        "softening with use",
    ),
    "self_heating": (
        "bends differently the more it moves, as if it warmed up",
        "dependence on recent motion",
    ),
    "crosstalk": (
        "bends less with a chamber while others are under pressure and stiffen it",
        "crosstalk between chambers",
    ),
    "supply_sag": (
        "bends less after air was drawn, as if its supply sagged",
        "a supply that sags while air is drawn",
    ),
    "thermal": ("bends more or less when it is warm", "dependence on temperature"),
    "tracker": ("is measured wrongly", "an error or lag of the tracker"),
    "quantisation": ("follows its command in coarse steps", "coarse steps of the command"),
    "dead_band": ("stays where it is until its command has moved enough", "a dead band"),
    "warm_up": ("bends differently in the first minutes of a session", "change over the first minutes"),
}

# How a constant is shown in a list of causes.
CONSTANTS = {
    "time_s": "time constant {time_s:.2g} s",
    "frequency_rad_per_s": "{hz:.2g} Hz",
    "damping_ratio": "damping ratio {damping_ratio:.2g}",
    "fill_time_s": "{fill_time_s:.2g} s to fill",
    "vent_time_s": "{vent_time_s:.2g} s to vent",
    "threshold_kpa": "from {threshold_kpa:.2g} kPa",
    "width_kpa": "width {width_kpa:.2g} kPa",
    "centre_kpa": "at {centre_kpa:.2g} kPa",
}

_HOLD = (
    "Step to half and to full pressure, hold three time constants each, vent as long: the bend goes on and "
    "then stops"
)
# What to record to distinguish a law from its neighbours; `diagnosis.law_programs` makes a program of each.
EXPERIMENTS = {
    "stairs": "Go up and down in ten equal stairs: what depends on the pressure alone is the same on both "
    "ways.",
    "turns": "Go back and forth by small and by large steps, slowly and quickly: the loop is as wide at both "
    "paces.",
    "paces": "Go up and down at three paces, a factor of three apart, and stop: it differs by the pace "
    "alone.",
    "threshold": "Go up in small stairs through the threshold: each step differs above it, none below.",
    "hold": f"{_HOLD}.",
    "hold, squared": f"{_HOLD}, four times as much at the full pressure.",
    "hold, then less": (
        "Hold the full pressure, then go to half of it: it bends differently there than after a rest."
    ),
    "hold, by pressure": "Step to half and to full pressure and hold each: the bend goes on at another pace.",
    "hold, by warmth": "Step and hold, cold and warm: the bend goes on at another pace.",
    "hold for long": "Step, hold 100 s, vent as long: the bend still goes on from 10 to 100 s.",
    "loss": "Hold a pressure for long: the bend falls at a steady pace, and not while the pressure moves.",
    "fill and vent": "Step up and down to two levels, at 20 Hz or more: filling and venting take other "
    "times.",
    "swing": "Step up and down at ten samples a swing or more: it swings about where it ends.",
    "fading": "Small strokes, one to the top, small ones again for three time constants: the change fades.",
    "staying": "Small strokes, one to the top, small ones again, also after a rest: the change stays.",
    "strokes": "After a night's rest make many equal strokes: each differs a little less from the one "
    "before.",
    "chambers": "Go up and down with one chamber, while the others are empty and while they are full.",
    "filling": "Hold one chamber and fill the others at once: it loses pressure, and has it back soon.",
    "snap": "Go slowly through the snap and back: it comes at a higher pressure on the way up.",
    "small stairs": "Go up and down by steps smaller than the band, if your regulator can: nothing moves "
    "until they add up to it.",
    "from rest": "After a night's rest make a stroke now and then: it changes with the time alone.",
    "warming": "Make equal strokes while it warms, for several time constants: they follow the temperature "
    "late.",
    "motion": "Make quick strokes, then hold: what the motion changed comes back, by as much at low as at "
    "high pressures.",
    "motion, by pressure": "Make quick strokes, then hold: what the motion changed comes back, more so about "
    "high pressures.",
}

# ---------------------------------------------------------------- the catalogue

# Condition column to its zero and unit.
COUNTED = {
    "temperature_c": (REFERENCE_C, 10.0), "session_time_s": (0.0, 1.0), "gravity_y": (0.0, 1.0),
    "payload_g": (0.0, 10.0),
}  # fmt: skip


# Constant to its symbol in the equations; a `width_kpa` is r, as every other one that is not named here.
SYMBOLS = {
    "scale_kpa": "P", "time_s": "tau", "fill_time_s": "tau_+", "vent_time_s": "tau_-", "rate_1_per_s": "k",
    "times_per_10_k": "k", "times_at_full_pressure": "k", "frequency_rad_per_s": "omega",
    "damping_ratio": "zeta", "exponent": "c", "slope": "c", "threshold_kpa": "a", "centre_kpa": "a",
    "slope_kpa": "b", "width_down_kpa": "l", "path_kpa": "n_0",
}  # fmt: skip
# What stands in the equations, and what it is.
TERMS = {
    "lag": "lag_tau(f) is y of tau dy/dt = f - y; of two times tau_+ holds where f > y, tau_- elsewhere",
    "springpot": "springpot_c(f) is the mean of lag_tau(f) over 12 tau from 0.1 to 400 s, weighted by tau^c",
    "play": "play_r(f) is y that moves with f only where |f - y| would exceed r (play_r,l: r up, l down)",
    "band": "band_r(f) is y that becomes f where |f - y| exceeds r",
    "loop": "loop_r(f) is y of dy/dt = df/dt - |df/dt| |y/r|^0.3 y/r",
    "mode": "mode_omega,zeta(f) is y of d^2y/dt^2 + 2 zeta omega dy/dt + omega^2 (y - f) = 0",
    "peak": "peak_tau(f) is the largest f so far, which fades with exp(-t/tau)",
    "p_{max}": "p_max is the largest p so far",
    "p_{others}": "p_others is the sum of the other chambers' pressures",
    "t_{held}": "t_held is the time since p changed last",
    r"\Delta T": "dT is (temperature_c - 23) / 10",
    "e^{-t/": "t is session_time_s",
    "L": "L is the length of the straight device",
}


def terms_of(equation: str) -> list[str]:
    """What the operators in an equation of a law do, a line each."""
    return [line for term, line in TERMS.items() if term in equation]


def _symbol(name: str) -> str:
    return f"{SYMBOLS.get(name, 'r')} ({name})"


@dataclass(frozen=True)
class Law:
    """One law of the drive."""

    memory: Callable  # M
    family: str  # the library's name for such physics, see `FAMILIES`
    equation: str  # LaTeX of what is added; after `\quad` what a symbol in it is
    experiment: str  # what shows it, see `EXPERIMENTS`
    constants: tuple[Parameter, ...] = ()  # of the memory, with bounds
    # constants with which a search begins, in units of the parameters' default
    starts: tuple[tuple[float, ...], ...] = ((),)
    input: Callable = pressure  # f
    gain: bool = False  # whether it is a gain; otherwise it is added
    minus: bool = False  # whether the memory's input is taken off, so that nothing is left in steady state
    column: str = ""  # condition that it needs
    scaled: bool = False  # whether the condition is a factor; otherwise it moves a constant or is the input
    cause: str = ""  # in a list of causes; empty for the family's

    def effect(self, name: str) -> BodyEffect:
        """The effect of this name, `lag(p)` or `lag(p) #2`."""
        several = self.input in SHARED
        # pressure in a chamber stiffens the body against its neighbours, and a supply only sags; errors of a
        # tracker look otherwise
        weight = Parameter("weight", "", *((-0.05, -3.0, 0.0) if several else (0.05, -3.0, 3.0)))
        scale = Parameter("scale_kpa", "kPa", 1.0, 1e-3, 3.0, neutral=1.0, fixed=True, range_power=1)
        term, comma, where = self.equation.partition(r", \quad ")
        own = [p for p in (scale, *self.constants) if p is not scale or "P" in term + where]
        numbers = ", ".join(f"{_symbol(p.name)} = {{{p.name}:.3g}}" for p in own)
        factor = plain_equation(term)
        if re.search(r"^-|[+-] ", re.sub(r"\(.*\)", "", factor)):  # a sum, not a product
            factor = f"({factor})"
        shown = f"p + {{weight:.3g}} {factor}" + f", {plain_equation(where)}" * bool(where)
        return BodyEffect(
            name=name,
            stage="drive",
            run=partial(run_drive, **self.choices()),
            parameters=(weight, scale, *self.constants),
            columns=(self.column,) if self.column else (),
            at_reference=self.column == "temperature_c",
            state_size=lambda channels: SLOTS * channels,
            apart=not several,
            several=several,
            linear="weight",
            equation=rf"p \to p + w\,({term}){comma}{where}",
            cause="{kind}",
            summary=f"Your {{device}} {{does}}: the pressure p that bends it becomes {shown}"
            + (f", with {numbers}." if numbers else "."),
            experiment=EXPERIMENTS[self.experiment],
            derive=partial(_shown, name),
        )

    def choices(self) -> dict:
        """Arguments of `run_drive` that the law fixes."""
        counted = COUNTED[self.column] if self.column else ()
        return {
            "input": self.input, "memory": self.memory, "late": int(self.input in OF_RATE),
            "gain": self.gain, "minus": self.minus, "scaled": self.scaled, "counted": counted,
        }  # fmt: skip


# Feature in a law's name to its LaTeX; those of the tip are in lengths L, so that the weight has no unit.
_FEATURES = {
    "z^2": "z^2/L", "x z": r"x\,z/L", "dT": r"L\,\Delta T", "g_y": r"L\,g_y", "m g_y": r"L\,m\,g_y",
    "bend^2": r"\mathrm{bend}^2", "dT of bend": r"\Delta T",
}  # fmt: skip


@dataclass(frozen=True)
class SeenLaw:
    """One law of what is seen: an output gains a feature."""

    out: int  # index of the output, tip x, y, z or bend
    feature: Callable  # of the markers (n, 5), the length in mm and the product of the counted conditions
    columns: tuple[str, ...] = ()  # conditions that it needs
    family: str = "tracker"  # the library's name for such physics
    cause: str = "an error of the measured tip"  # in a list of causes

    def effect(self, name: str) -> BodyEffect:
        """The effect of this name."""
        structure, of_tip = name.partition(" #")[0], self.out < 3
        output, _, feature = structure.partition(" += ")
        feature = _FEATURES[feature if of_tip or feature != "dT" else "dT of bend"]
        counted = tuple(COUNTED[c] for c in self.columns)
        return BodyEffect(
            name=name,
            stage="material" if of_tip else "observation",
            signal="markers",
            run=partial(run_seen, out=self.out, feature=self.feature, counted=counted),
            parameters=(Parameter("weight", "", 0.01, -1.0, 1.0),),
            columns=("length_mm", *self.columns),
            equation=rf"{output} \to {output} + w\,{feature}",
            cause=self.cause,
            summary=f"The {'tip' if of_tip else 'bend'} of your {{device}} is off: "
            f"{output} becomes {output} + {{weight:.2g}} {plain_equation(feature)}.",
            experiment="Look at the same motion with a second camera.",
        )


def _time(default=1.0, lower=0.02, upper=200.0, name="time_s") -> Parameter:
    return Parameter(name, "s", default, lower, upper, log=True)


def _width(default=0.1, upper=0.9, name="width_kpa", lower=0.003) -> Parameter:
    return Parameter(name, "kPa", default, lower, upper, log=True, range_power=1)


_TIMES = ((0.1,), (0.3,), (1.0,), (3.0,), (10.0,), (30.0,), (100.0,))
_SHORT_TO_LONG = ((1.0,), (10.0,), (60.0,))
_BY_WARMTH = Parameter("times_per_10_k", "", 0.4, 0.05, 3.0, neutral=1.0, log=True)
_BY_PRESSURE = Parameter("times_at_full_pressure", "", 0.3, 0.01, 10.0, neutral=1.0, log=True)
_SPECTRAL = Parameter("exponent", "", 0.0, -1.1, 1.1, neutral=9.0)
_POWER = Parameter("exponent", "", 1.0, 0.2, 5.0, neutral=1.0, log=True)
_SLOPE = Parameter("slope", "", 1.0, 0.1, 8.0, neutral=0.0, log=True)
_FLIP = (_width(0.05), _width(0.5, 1.2, "centre_kpa", 0.02), _width(0.15, 1.0, "slope_kpa", 0.03))
_FILL_VENT = (_time(0.3, 0.02, 5.0, "fill_time_s"), _time(0.6, 0.02, 5.0, "vent_time_s"))
_CROSSING = (_width(0.1, 5.0, "rate_kpa_per_s", 0.005), _time(0.05, 0.005, 2.0))
_OMEGA_ZETA = (
    Parameter("frequency_rad_per_s", "rad/s", 10.0, 0.5, 60.0, log=True),
    Parameter("damping_ratio", "", 0.3, 0.02, 2.0, log=True),
)
_MODES = tuple((2 * math.pi * f, z) for f in (0.5, 1.0, 2.0, 4.0) for z in (0.1, 0.5))
_MANY = "creep over many time scales"

# fmt: off
# Name to law, in the order in which laws act: statics, plays, memories, history, conditions.
TABLE = {
    "power(p)": Law(power, "stiffening", r"P\,\mathrm{sign}(p)\,|p/P|^c - p", "stairs",
                    (_POWER,), ((0.6,), (1.6,)), minus=True),
    "tanh(p)": Law(tanh, "gain_saturation", r"P\tanh(c\,p/P)/c - p", "stairs",
                   (_SLOPE,), ((1.0,), (3.0,)), minus=True),
    "hinge(p)": Law(hinge, "contact", r"\max(p - a, 0)", "threshold",
                    (_width(0.5, 0.95, "threshold_kpa", 0.05),), ((0.3,), (0.6,))),
    "p^2": Law(none, "stiffening", r"p\,|p|/P", "stairs", input=squared),
    "p^3": Law(cube, "stiffening", r"p^3/P^2 - p", "stairs", minus=True),
    "step(p)": Law(step, "stiffening", r"P\tanh((p - a)/b)", "stairs",
                   _FLIP[1:], ((0.2, 0.15), (0.5, 0.15), (0.8, 0.15))),
    "p others(p)": Law(none, "crosstalk", r"p\,p_{others}/P", "chambers",
                       input=others, gain=True),
    "play(p)": Law(play, "hysteresis", r"\mathrm{play}_r(p) - p", "turns",
                   (_width(),), ((0.03,), (0.1,), (0.25,)), minus=True),
    "dead_band(p)": Law(dead_band, "dead_band", r"\mathrm{band}_r(p) - p", "small stairs",
                        (_width(0.05),), ((0.02,), (0.06,), (0.15,)), minus=True),
    "round(p)": Law(rounded, "quantisation", r"r\,\mathrm{round}(p/r) - p", "small stairs",
                    (Parameter("step_kpa", "kPa", 0.1, 0.01, 0.5, log=True, range_power=1, jump=0.06),),
                    tuple((float(s),) for s in np.geomspace(0.02, 0.3, 80)), minus=True),
    "play_two(p)": Law(play_two, "hysteresis", r"\mathrm{play}_{r,l}(p) - p", "turns",
                       (_width(name="width_up_kpa"), _width(name="width_down_kpa")),
                       ((0.1, 0.01), (0.01, 0.1)), minus=True),
    "play(p)^3": Law(play_cubed, "hysteresis", r"\mathrm{play}_r(p)^3/P^2 - p", "turns",
                     (_width(),), ((0.1,),), minus=True),
    "loop(p)": Law(loop, "hysteresis", r"\mathrm{loop}_r(p)", "turns",
                   (_width(lower=0.01),), ((0.03,), (0.1,), (0.25,))),
    "p play(p)": Law(play, "hysteresis", r"p\,(\mathrm{play}_r(p) - p)/P", "turns",
                     (_width(),), ((0.1,),), gain=True, minus=True),
    "flip(p)": Law(flip, "snap", r"P\tanh((\mathrm{play}_r(p) - a)/b)", "snap",
                   _FLIP, ((0.05, 0.2, 0.15), (0.05, 0.5, 0.15), (0.05, 0.8, 0.15))),
    "lag(p)": Law(lag, "creep", r"\mathrm{lag}_\tau(p) - p", "hold", (_time(),), _TIMES, minus=True),
    "lag(p^2)": Law(lag, "creep", r"\mathrm{lag}_\tau(p\,|p|)/P", "hold, squared",
                    (_time(),), _TIMES, input=squared),
    "power_law_memory(p)": Law(spectrum, "creep", r"\mathrm{springpot}_c(p) - p", "hold for long",
                               (_SPECTRAL,), ((0.0,), (-0.4,), (0.4,)), minus=True, cause=_MANY),
    "power_law_memory(p^2)": Law(spectrum, "creep", r"\mathrm{springpot}_c(p\,|p|)/P", "hold for long",
                                 (_SPECTRAL,), ((0.0,),), input=squared, cause=_MANY),
    "p lag(p)": Law(lag, "creep", r"p\,\mathrm{lag}_\tau(p)/P", "hold, then less",
                    (_time(),), _SHORT_TO_LONG, gain=True),
    "p lag(p^2)": Law(lag, "creep", r"p\,\mathrm{lag}_\tau(p\,|p|)/P^2", "hold, then less",
                      (_time(),), _SHORT_TO_LONG, input=squared, gain=True),
    "lag(p; time moves with p)": Law(lag_pressure, "creep", r"\mathrm{lag}_{\tau k^{p/P}}(p) - p",
                                     "hold, by pressure", (_time(), _BY_PRESSURE),
                                     ((3.0, 0.3), (20.0, 0.3)), minus=True),
    "fill_vent(p)": Law(fill_vent, "valve_lag", r"\mathrm{lag}_{\tau_+,\tau_-}(p) - p", "fill and vent",
                        _FILL_VENT, ((0.3, 0.6),), minus=True),
    "mode(p)": Law(mode, "ringing", r"\mathrm{mode}_{\omega,\zeta}(p) - p", "swing",
                   _OMEGA_ZETA, _MODES, minus=True),
    "held(p)": Law(held, "leak", r"-p\,(1 - e^{-k\,t_{held}})", "loss",
                   (Parameter("rate_1_per_s", "1/s", 0.05, 0.001, 2.0, log=True),), ((0.05,),)),
    "tanh(dp/dt)": Law(tanh_of_lag, "friction", r"P\tanh(\mathrm{lag}_\tau(\dot p)/r)", "paces",
                       _CROSSING, ((0.1, 0.05), (0.5, 0.05)), input=rate),
    "p tanh(|dp/dt|)": Law(tanh_of_lag, "rate", r"p\tanh(\mathrm{lag}_\tau(|\dot p|)/r)", "paces",
                           _CROSSING, ((0.3, 0.05),), input=speed, gain=True),
    "p root lag(|dp/dt|)": Law(root_of_lag, "rate", r"p\sqrt{\mathrm{lag}_\tau(|\dot p|)/P}", "paces",
                               (_time(0.2, 0.02, 3.0),), ((0.2,),), input=speed, gain=True),
    "p fading_max(p)": Law(fading_max, "cyclic_softening", r"p\,(\mathrm{peak}_\tau(p) - p)/P", "fading",
                           (_time(10.0, 0.2),), _SHORT_TO_LONG, gain=True, minus=True),
    "p tanh(fading_max(p))": Law(below_fading_max, "cyclic_softening",
                                 r"p\tanh((\mathrm{peak}_\tau(p) - p)/r)", "fading",
                                 (_time(30.0, 0.2), _width(0.2)),
                                 ((20.0, 0.2), (100.0, 0.2)), gain=True),
    "p below_max(p)": Law(below_max, "cyclic_softening", r"p\,(1 - \max(p, 0)/p_{max})^c", "staying",
                          (Parameter("exponent", "", 1.5, 0.3, 4.0, log=True),), ((1.5,),), gain=True),
    "p damage(p)": Law(damage, "cyclic_softening",
                       r"p\,(1 - e^{-D}), \quad \dot D = \max(p/P, 0)^c/\tau", "staying",
                       (_time(60.0, 1.0, 2000.0), Parameter("exponent", "", 3.0, 1.0, 12.0, log=True)),
                       ((20.0, 3.0), (100.0, 3.0), (100.0, 8.0)), gain=True),
    "p path(p)": Law(path, "cyclic_softening", r"p\,n/(n + n_0), \quad n = \int |dp|", "strokes",
                     (_width(10.0, 200.0, "path_kpa", 0.5),), ((10.0,),), gain=True),
    "p lag(|dp/dt|)": Law(lag, "self_heating", r"p\,\mathrm{lag}_\tau(|\dot p|)/P", "motion",
                          (_time(90.0, 3.0, 200.0),), ((30.0,), (90.0,)), input=speed, gain=True),
    "p lag(p |dp/dt|)": Law(lag, "self_heating", r"p\,\mathrm{lag}_\tau(|p\,\dot p|)/P^2",
                            "motion, by pressure",
                            (_time(90.0, 3.0, 200.0),), ((30.0,), (90.0,)), input=work, gain=True),
    "p lag(drawn)": Law(lag, "supply_sag", r"p\,\mathrm{lag}_\tau(Q)/P, \quad Q = \sum\max(\dot p, 0)",
                        "filling", (_time(5.0, 0.5, 60.0),), ((3.0,), (10.0,)), input=drawn, gain=True),
    "p exp(-t)": Law(fading_time, "warm_up", r"p\,e^{-t/\tau}", "from rest",
                     (_time(100.0, 10.0, 2000.0),), ((60.0,), (200.0,)), gain=True, column="session_time_s"),
    "p lag(dT)": Law(lag, "thermal", r"p\,\mathrm{lag}_\tau(\Delta T)", "warming",
                     (_time(60.0, 3.0, 1000.0),), ((20.0,), (100.0,), (400.0,)),
                     input=condition, gain=True, column="temperature_c"),
    "p dT": Law(none, "thermal", r"p\,\Delta T", "stairs", column="temperature_c", scaled=True),
    "lag(p) dT": Law(lag, "thermal", r"(\mathrm{lag}_\tau(p) - p)\,\Delta T", "hold",
                     (_time(),), _SHORT_TO_LONG, minus=True, column="temperature_c", scaled=True),
    "lag(p; time moves with dT)": Law(lag_warm, "creep", r"\mathrm{lag}_{\tau k^{\Delta T}}(p) - p",
                                      "hold, by warmth", (_time(), _BY_WARMTH),
                                      ((1.0, 0.37), (10.0, 0.37), (50.0, 0.37)),
                                      minus=True, column="temperature_c"),
}
# fmt: on


def z_squared(x, length, c):
    return x[:, 2] * x[:, 2] / (length * length)


def x_z(x, length, c):
    return x[:, 0] * x[:, 2] / (length * length)


def bend_squared(x, length, c):
    return x[:, 3] * x[:, 3]


def counted_condition(x, length, c):
    return c


_OF_BEND = "an error of the measured bend"
SEEN = {
    **{
        f"tip_{a} += {f}": SeenLaw(i, feature)
        for i, a in enumerate("xyz")
        for f, feature in (("z^2", z_squared), ("x z", x_z))
    },
    **{f"tip_{a} += dT": SeenLaw(i, counted_condition, ("temperature_c",)) for i, a in enumerate("xyz")},
    "tip_y += g_y": SeenLaw(1, counted_condition, ("gravity_y",), "gravity", "a sag to the side"),
    "tip_y += m g_y": SeenLaw(
        1, counted_condition, ("gravity_y", "payload_g"), "payload", "a sag to the side under the load"
    ),
    "bend += bend^2": SeenLaw(3, bend_squared, cause=_OF_BEND),
    "bend += dT": SeenLaw(3, counted_condition, ("temperature_c",), cause=_OF_BEND),
}
TRACKER = "tracker_lag"
# fmt: off
# Law to its plain name in sentences.
PLAIN = {
    "power(p)": "a gain that follows a power of the pressure",
    "tanh(p)": "a gain that saturates with pressure",
    "hinge(p)": "another gain above a threshold of the pressure",
    "p^2": "a gain that grows with pressure",
    "p^3": "a gain that grows with the square of the pressure",
    "step(p)": "a smooth step of the bend at a pressure",
    "p others(p)": "a gain that falls with the other chambers' pressure",
    "play(p)": "play between pressure and bend",
    "dead_band(p)": "a dead band of small steps of the pressure",
    "round(p)": "a command in coarse steps",
    "play_two(p)": "play of different widths up and down",
    "play(p)^3": "cubed play between pressure and bend",
    "loop(p)": "a Bouc-Wen loop between pressure and bend",
    "p play(p)": "play that grows with pressure",
    "flip(p)": "play through a sigmoid",
    "lag(p)": "a lag between pressure and bend",
    "lag(p^2)": "a lag of the squared pressure",
    "power_law_memory(p)": "a power-law memory of the pressure",
    "power_law_memory(p^2)": "a power-law memory of the squared pressure",
    "p lag(p)": "a gain that follows past pressure",
    "p lag(p^2)": "a gain that follows past squared pressure",
    "lag(p; time moves with p)": "a lag whose time changes with pressure",
    "fill_vent(p)": "lags of different times up and down",
    "mode(p)": "a damped swing of the bend",
    "held(p)": "a loss while the pressure is held",
    "tanh(dp/dt)": "friction by the sign of the pressure's rate",
    "p tanh(|dp/dt|)": "a gain that saturates with the pressure's rate",
    "p root lag(|dp/dt|)": "a gain that follows the root of the pressure's rate",
    "p fading_max(p)": "softening by the recent largest pressure",
    "p tanh(fading_max(p))": "softening well below the recent largest pressure",
    "p below_max(p)": "softening below the largest pressure so far",
    "p damage(p)": "softening with the time under pressure",
    "p path(p)": "softening with use",
    "p lag(|dp/dt|)": "softening by recent motion",
    "p lag(p |dp/dt|)": "softening by recent motion under pressure",
    "p lag(drawn)": "a gain that falls with the air drawn lately",
    "p exp(-t)": "a gain that settles as the session goes on",
    "p lag(dT)": "a gain that follows the temperature late",
    "p dT": "a gain that follows the temperature",
    "lag(p) dT": "a lag that grows with temperature",
    "lag(p; time moves with dT)": "a lag whose time changes with temperature",
    **{f"tip_{a} += {f}": f"an error of the measured tip along {a} by {g}"
       for a in "xyz"
       for f, g in (("z^2", "z squared"), ("x z", "x times z"), ("dT", "temperature"))},
    "tip_y += g_y": "a sag to the side",
    "tip_y += m g_y": "a sag to the side under the load",
    "bend += bend^2": "an error of the measured bend by its square",
    "bend += dT": "an error of the measured bend by temperature",
    TRACKER: "a lag of the tracker",
}
# fmt: on


def law_names() -> list[str]:
    """All laws, in the order in which they act."""
    return [*TABLE, *SEEN, TRACKER]


def is_law(name: str) -> bool:
    """Whether a name is that of a law, `lag(p)` or its second instance `lag(p) #2`."""
    structure, mark, number = name.partition(" #")
    known = structure in TABLE or structure in SEEN or structure == TRACKER
    return known and (not mark or number.isdigit())


ORDINALS = ("second", "third", "fourth", "fifth", "sixth")


def plain_name(name: str) -> str:
    """The name in sentences; `play(p) #2` is `play between pressure and bend, second one`."""
    structure, _, number = name.partition(" #")
    plain = PLAIN.get(structure, structure).replace("_", " ")
    return f"{plain}, {ORDINALS[int(number) - 2]} one" if number and is_law(name) else plain


@cache
def law(name: str) -> BodyEffect:
    """The effect that a law's name says; the same structure may act twice, the second as `lag(p) #2`.

    Raises KeyError where the catalogue has no such law.
    """
    structure = name.partition(" #")[0]
    if structure != TRACKER:
        return (TABLE.get(structure) or SEEN[structure]).effect(name)
    return BodyEffect(
        name=name,
        stage="observation",
        run=run_tracker,
        parameters=(Parameter("time_s", "s", 0.1, 0.005, 2.0, log=True),),
        state_size=lambda channels: 3 * channels,
        equation=r"\tau\,\dot y = x - y",
        cause="a slow tracker, time constant {time_s:.2g} s",
        summary="What tracks your {device} lags by {time_s:.2g} s.",
        experiment="Watch a thing that is moved by hand with the tracker and with a ruler's shutter.",
    )


def _shown(name: str, values: Mapping[str, float]) -> dict:
    """The words for a law's family, its constants where these are of that family, and a frequency in Hz."""
    found = family(name, values)
    does, kind = FAMILIES[found]
    w = values.get("frequency_rad_per_s")
    shown = dict(values) | ({} if w is None else {"hz": w / (2 * math.pi)})
    own = TABLE[name.partition(" #")[0]]
    if found == own.family:
        constants = [CONSTANTS[p.name].format(**shown) for p in own.constants if p.name in CONSTANTS]
        kind = ", ".join([own.cause or kind, *constants])
    return {"does": does, "kind": kind}


QUICK_S = 0.2  # a lag that is over by then is of the air or the tracker; materials creep for seconds
ABRUPT = 0.1  # of the range: a snap comes within
FAST = 1.0  # ranges a second: friction that still grows there is viscous
OPEN = 0.5  # of the range: a valve that opens in proportion over more of it makes a lag, not a ramp
COOLING_S = 20.0  # a wall of 2 mm cools in minutes: what motion changes for a shorter time is no heat
GROWS = (
    0.2  # of the vent rate, over the range: an orifice vents faster from a higher pressure, a ramp does not
)
STATIC = 0.1  # of how far a curve bends off a line: with a smaller residual, a law is that curve alone
SWINGS = 0.05  # of a step: less overshoot, as from a damping ratio of 0.7 on, is no oscillation

_NAMED = {e.name: e for e in (air_resonance.EFFECT, hysteresis.EFFECT)}  # named by what they do, as laws are
_STATIC = {e.name: e for e in (gain_saturation.EFFECT, stiffening.EFFECT)}
_CURVES = ("stiffening", "gain_saturation")  # families of static curves
_LOOPS = ("hysteresis", "snap")  # families of what depends on the direction, at any pace
_LATE = ("creep", "valve_lag", "ringing", "air_resonance", "leak")  # and of what goes on after a step

# Slow strokes to the top, half way and to the top, in shares of the range times 100.
_STROKES = np.r_[0:101, 99:-1:-1, 1:51, 49:-1:-1, 1:101, 99:-1:-1]
_UP, _DOWN = slice(-201, -100), slice(-1, -102, -1)  # the last stroke
_STROKE_S = 20.0  # to the top
_AFTER_S = np.geomspace(1e-3, 1e4, 141)  # seconds after a step
_HELD = _AFTER_S > 1.0


@dataclass(frozen=True)
class Response:
    """What an effect with fitted constants does to a pressure; pressures are shares of the range."""

    curve: np.ndarray  # (101,) what it adds at 0 to the range, the mean of both ways of a slow stroke
    of_largest: bool  # whether the largest pressure so far matters, and hardly the direction
    static: bool  # whether it does nothing but that curve
    rises: bool  # whether the pressure goes on rising after a step up; else it overshoots and falls back
    swings: bool  # whether it goes beyond where it ends
    time_s: float  # until 37 % of what is late is left


@cache
def _response(name: str, values: tuple[tuple[str, float], ...], range_kpa: float) -> Response:
    """Runs an effect on slow strokes and on a step."""
    effect = law(name) if is_law(name) else (_NAMED | _STATIC)[name]

    def added(share: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """What it adds to the pressure, (n,)."""
        usual = np.array([[COUNTED[c][0] for c in effect.columns]])
        x = share * range_kpa
        after = effect.apply(x, dt, dict(values), np.repeat(usual, len(x), axis=0))
        return (after - x) / range_kpa

    strokes = _STROKES / 100
    slow = added(strokes, np.full(len(strokes), _STROKE_S / 100))
    slowest = added(strokes, np.full(len(strokes), 1e4))
    step = added(np.r_[0.0, np.ones(len(_AFTER_S))], np.r_[np.inf, np.diff(_AFTER_S, prepend=0.0)])[1:]
    curve = 0.5 * (slow[_UP] + slow[_DOWN])
    bent = np.abs(curve - np.linspace(curve[0], curve[-1], 101)).max()
    residual = max(np.abs(slow - curve[_STROKES]).max(), np.abs(step[_HELD] - curve[-1]).max())
    loop, late = np.abs(slowest[_UP] - slowest[_DOWN]).max(), step - step[-1]
    size = max(abs(late[0]), 1e-12)
    return Response(
        curve,
        of_largest=bool(loop < STATIC * np.abs(slowest[:101] - slowest[_UP]).max()),
        static=bool(residual < STATIC * bent),
        rises=bool(late[0] < 0),
        swings=bool(np.max(-np.sign(late[0]) * late) > SWINGS * size),
        time_s=float(_AFTER_S[np.argmax(np.abs(late) < size / math.e)]),
    )


def curve(name: str, values: Mapping[str, float], range_kpa: float = 0.0) -> np.ndarray:
    """What an effect adds on slow strokes from 0 to the range, (101,), in ranges, the mean of both ways.

    0 of an effect that is not of the pressure.

    Args:
        name: of an effect.
        values: its constants.
        range_kpa: largest pressure, where the constants do not give it.
    """
    range_kpa = values.get("scale_kpa", range_kpa)
    if not range_kpa or (name.partition(" #")[0] not in TABLE and name not in _NAMED | _STATIC):
        return np.zeros(101)
    return _response(name, tuple(values.items()), range_kpa).curve


def curvature(name: str, values: Mapping[str, float], range_kpa: float = 0.0) -> float:
    """Second difference of a static curve over half the range, of the range; 0 of an effect that is none.

    Positive where each further kPa bends more; arguments as of `curve`.
    """
    if _kind(name, values) not in _CURVES:
        return 0.0
    shape = curve(name, values, range_kpa)
    return float(shape[100] - 2 * shape[50] + shape[0])


def family(name: str, values: Mapping[str, float] | None = None) -> str:
    """What the library calls the physics of an effect; the name itself where it has no name for it.

    One equation may be several kinds of physics. With its fitted constants it is called by what it does on
    slow strokes and after a step: play through a sigmoid (`flip(p)`, generalised Prandtl-Ishlinskii operator)
    is a snap where it is abrupt, hysteresis where it is not, and a static curve where its width does nothing.
    """
    if not values:
        return _declared(name)
    kind = _kind(name, values)
    bent = curvature(name, values)
    return ("stiffening" if bent > 0 else "gain_saturation") if bent else kind


def _declared(name: str) -> str:
    structure = name.partition(" #")[0]
    entry = TABLE.get(structure) or SEEN.get(structure)
    return entry.family if entry else "tracker" if structure == TRACKER else name


def _kind(name: str, values: Mapping[str, float]) -> str:
    structure, kind = name.partition(" #")[0], _declared(name)
    range_kpa = values.get("scale_kpa", 1.0)
    if structure == "tanh(dp/dt)" and values["rate_kpa_per_s"] > FAST * range_kpa:
        return "rate"
    if structure == "valve_slew" and values["band_kpa"] > OPEN * range_kpa:
        return "valve_lag"
    if structure == "valve_slew" and values["vent_growth"] > GROWS:
        return "orifice_flow"
    if kind == "self_heating" and structure in TABLE and values["time_s"] < COOLING_S:
        return "cyclic_softening" if values["weight"] > 0 else "rate"
    if name == "hysteresis":
        range_kpa = 2 * values["width_kpa"]
    elif structure not in TABLE and name not in _NAMED:
        return kind
    if kind not in (*_LOOPS, *_LATE):
        return kind
    response = _response(name, tuple(values.items()), range_kpa)
    if response.static:
        return "stiffening"
    if kind in _LOOPS:
        if response.of_largest:
            return "cyclic_softening"
        return "hysteresis" if kind == "snap" and values["slope_kpa"] > ABRUPT * range_kpa else kind
    if (kind in ("ringing", "air_resonance") and response.swings) or (kind == "leak" and not response.rises):
        return kind
    quick = response.time_s < QUICK_S
    if not response.rises:
        return "overshoot" if quick else "relaxation"
    return "valve_lag" if quick or kind in ("valve_lag", "air_resonance") else "creep"


def starts(name: str) -> tuple[tuple[float, ...], ...]:
    """Constants with which a search begins, in units of the parameters' own scale."""
    structure = name.partition(" #")[0]
    return TABLE[structure].starts if structure in TABLE else ((),)
