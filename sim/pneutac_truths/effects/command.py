"""Between the computer and the regulator's output: what reaches the tube is not what was asked for."""

from functools import partial

import numpy as np
from numba import njit

from pneutac_truths.effects.table import effect
from pneutac_truths.programs import DT_S
from pneutac_truths.world import World, seconds

acts = partial(effect, "command")


@acts(
    "Commands reach the regulator late (bus and valve driver).",
    "Nilsson, Real-time control systems with delays, thesis, Lund (1998)",
    size=(0.01, 0.8),
)
def dead_time(w: World, size: float) -> None:
    """`size`: delay in s."""
    k = seconds(size)
    w.sent = np.concatenate([np.zeros((k, w.sent.shape[1])), w.sent[:-k]])


@acts(
    "The valve stays where it is until the command has moved by more than its dead band.",
    "Beater, Pneumatic Drives (2007) ch. 7 (overlap of spools); SMC ITV series catalogue (sensitivity)",
    settle=(0.05, 0.5),
    size=(0.01, 0.25),
)
def valve_deadband(w: World, settle: float, size: float) -> None:
    """`size`: dead band, share of the top pressure; it stops at `settle` of the band from the command."""
    w.sent = _deadband(w.sent, size, settle * size)


@njit(cache=True)
def _deadband(sent, band, settle):
    out = np.empty_like(sent)
    for j in range(sent.shape[1]):
        x, moving = 0.0, False
        for i in range(len(sent)):
            miss = sent[i, j] - x
            if abs(miss) > band:
                moving = True
            if moving:
                x = sent[i, j] - np.sign(miss) * min(abs(miss), settle)
                moving = False
            out[i, j] = x
    return out


@acts(
    "The regulator's zero is another in each trial.",
    "SMC ITV series catalogue (repeatability, zero drift of electro-pneumatic regulators)",
    size=(0.003, 0.12),
)
def regulator_zero(w: World, size: float) -> None:
    """`size`: standard deviation over trials, share of the top pressure."""
    x = w.draws("regulator_zero").normal(size=(len(w.plan.starts), w.sent.shape[1]))
    if len(x) > 1:  # one trial alone has no spread
        x = (x - x.mean(0)) / x.std(0)
    zero = np.vstack([size * x, np.zeros(x.shape[1])])
    w.sent = w.sent + zero[w.plan.trial]


@acts(
    "The regulator's characteristic is bowed between its end points.",
    "SMC ITV series catalogue (linearity error)",
    way=(-1.0, 1.0),
    size=(0.005, 0.15),
)
def regulator_bow(w: World, way: float, size: float) -> None:
    """`size`: most it is off, at half the top pressure; upwards where `way` is positive."""
    w.sent = w.sent + np.where(way > 0, 1, -1) * size * 4 * w.sent * (1 - w.sent)


@acts(
    "The converter in front of the valve knows few steps.",
    "Widrow and Kollar, Quantization Noise (2008)",
    size=(0.01, 0.3),
)
def coarse_steps(w: World, size: float) -> None:
    """`size`: one step, share of the top pressure."""
    w.sent = np.round(w.sent / size) * size


@acts(
    "The regulator delivers less while it warms up after it was switched on.",
    "SMC ITV series catalogue (temperature characteristic)",
    minutes=(1.5, 5.0),
    size=(0.02, 0.5),
)
def regulator_warm_up(w: World, minutes: float, size: float) -> None:
    """`size`: share that is missing at first."""
    w.sent = w.sent * (1 - size * np.exp(-w.time_s / (60 * minutes)))[:, None]


@acts(
    "A proportional spool sticks and slides: the output has play against the command.",
    "Choudhury, Thornhill and Shah, Control Eng. Practice 13 (2005) 641: valve stiction",
    jump=(0.1, 0.6),
    size=(0.01, 0.25),
)
def valve_stiction(w: World, jump: float, size: float) -> None:
    """`size`: stick band, share of the top pressure; on letting go it slips by `jump` of it."""
    w.sent = _stiction(w.sent, size, jump * size)


@njit(cache=True)
def _stiction(sent, band, jump):
    out = np.empty_like(sent)
    for j in range(sent.shape[1]):
        x, sliding = 0.0, 0.0
        for i in range(len(sent)):
            miss = sent[i, j] - x
            if sliding * miss > 0:  # goes on as it went
                if abs(miss) > band - jump:
                    x = sent[i, j] - sliding * (band - jump)
            elif abs(miss) > band:
                sliding = np.sign(miss)
                x = sent[i, j] - sliding * (band - jump)
            out[i, j] = max(x, 0.0)
    return out


@acts(
    "The computer stalls at times, mostly at large changes; the regulator holds the last command.",
    "Nilsson, Real-time control systems with delays, thesis, Lund (1998)",
    per_minute=(4.0, 12.0),
    size=(0.03, 3.0),
)
def stalls(w: World, per_minute: float, size: float) -> None:
    """`size`: mean stall, s."""
    rng, t = w.draws("stalls"), w.time_s
    at = np.arange(len(t))
    change = np.abs(np.diff(w.plan.command, axis=0)).max(1)
    n = round(per_minute * t[-1] / 60)
    lasts = rng.uniform(0.3, 1.7, n) * size
    sends = rng.choice(t[1:], n, p=change / change.sum())
    for start, last in zip(sends - rng.uniform(0, 0.5, n) * lasts, lasts, strict=True):
        a, b = max(int(start / DT_S), 0), min(int((start + last) / DT_S) + 1, len(t))
        at[a:b] = np.minimum(at[a:b], at[a])
    w.sent = w.sent[at]
