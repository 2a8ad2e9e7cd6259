"""Between the computer and the regulator's output: what reaches the tube is not what was asked for."""

from functools import partial

import numpy as np

from pneutac_truths.effects.table import by_column, effect
from pneutac_truths.programs import DT_S
from pneutac_truths.world import World, seconds

acts = partial(effect, "command")


@acts(size=(0.01, 0.8))
def dead_time(w: World, size: float) -> None:
    """Commands reach the regulator late (bus and valve driver).

    `size`: delay in s. Source: Nilsson, Real-time control systems with delays, thesis, Lund (1998).
    """
    k = seconds(size)
    w.sent = np.concatenate([np.zeros((k, w.sent.shape[1])), w.sent[:-k]])


@acts(settle=(0.05, 0.5), size=(0.01, 0.25))
def valve_deadband(w: World, settle: float, size: float) -> None:
    """The valve stays where it is until the command has moved by more than its dead band.

    `size`: dead band, share of the top pressure; it stops at `settle` of the band from the command. Source:
    Beater, Pneumatic Drives (2007) ch. 7 (overlap of spools); SMC ITV series catalogue (sensitivity).
    """
    w.sent = _deadband(w.sent, size, settle * size)


@by_column
def _deadband(sent, out, band, settle):
    x, moving = 0.0, False
    for i in range(len(sent)):
        miss = sent[i] - x
        if abs(miss) > band:
            moving = True
        if moving:
            x = sent[i] - np.sign(miss) * min(abs(miss), settle)
            moving = False
        out[i] = x


@acts(size=(0.003, 0.12))
def regulator_zero(w: World, size: float) -> None:
    """The regulator's zero is another in each trial.

    `size`: standard deviation over trials, share of the top pressure. Source: SMC ITV series catalogue
    (repeatability, zero drift of electro-pneumatic regulators).
    """
    x = w.draws("regulator_zero").normal(size=(len(w.plan.starts), w.sent.shape[1]))
    if len(x) > 1:  # one trial alone has no spread
        x = (x - x.mean(0)) / x.std(0)
    zero = np.vstack([size * x, np.zeros(x.shape[1])])
    w.sent = w.sent + zero[w.plan.trial]


@acts(way=(-1.0, 1.0), size=(0.005, 0.15))
def regulator_bow(w: World, way: float, size: float) -> None:
    """The regulator's characteristic is bowed between its end points.

    `size`: most it is off, at half the top pressure; upwards where `way` is positive. Source: SMC ITV series
    catalogue (linearity error).
    """
    w.sent = w.sent + np.where(way > 0, 1, -1) * size * 4 * w.sent * (1 - w.sent)


@acts(size=(0.01, 0.3))
def coarse_steps(w: World, size: float) -> None:
    """The converter in front of the valve knows few steps.

    `size`: one step, share of the top pressure. Source: Widrow and Kollar, Quantization Noise (2008).
    """
    w.sent = np.round(w.sent / size) * size


@acts(minutes=(1.5, 5.0), size=(0.02, 0.5))
def regulator_warm_up(w: World, minutes: float, size: float) -> None:
    """The regulator delivers less while it warms up after it was switched on.

    `size`: share that is missing at first. Source: SMC ITV series catalogue (temperature characteristic).
    """
    w.sent = w.sent * (1 - size * np.exp(-w.time_s / (60 * minutes)))[:, None]


@acts(jump=(0.1, 0.6), size=(0.01, 0.25))
def valve_stiction(w: World, jump: float, size: float) -> None:
    """A proportional spool sticks and slides: the output has play against the command.

    `size`: stick band, share of the top pressure; on letting go it slips by `jump` of it. Source: Choudhury,
    Thornhill and Shah, Control Eng. Practice 13 (2005) 641: valve stiction.
    """
    w.sent = _stiction(w.sent, size, jump * size)


@by_column
def _stiction(sent, out, band, jump):
    x, sliding = 0.0, 0.0
    for i in range(len(sent)):
        miss = sent[i] - x
        if sliding * miss > 0:  # goes on as it went
            if abs(miss) > band - jump:
                x = sent[i] - sliding * (band - jump)
        elif abs(miss) > band:
            sliding = np.sign(miss)
            x = sent[i] - sliding * (band - jump)
        out[i] = max(x, 0.0)


@acts(per_minute=(4.0, 12.0), size=(0.03, 3.0))
def stalls(w: World, per_minute: float, size: float) -> None:
    """The computer stalls at times, mostly at large changes; the regulator holds the last command.

    `size`: mean stall, s. Source: Nilsson, Real-time control systems with delays, thesis, Lund (1998).
    """
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
