"""From the computer through the regulator to the pressure in the chamber; shares of the top pressure."""

import functools
import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numba import njit
from scipy.signal import lfilter

from pneutac_truths.effects.table import by_column, effect
from pneutac_truths.programs import DT_S
from pneutac_truths.world import World, seconds

of_air = partial(effect, "air")

AMBIENT_KPA = 101.3


def flows(kernel: Callable) -> Callable:
    """`by_column` of a kernel whose air moves over each step of the grid by what was asked at its start.

    So nothing moves before its command was sent.
    """
    run = by_column(kernel)
    return functools.wraps(kernel)(lambda x, *constants: run(np.concatenate([x[:1], x[:-1]]), *constants))


@flows
def _uneven_lag(u, out, up, down):
    a, b = 1.0 - math.exp(-DT_S / up), 1.0 - math.exp(-DT_S / down)
    x = u[0]
    for i in range(len(u)):
        x += (a if u[i] > x else b) * (u[i] - x)
        out[i] = x


def lag(x: np.ndarray, tau: float) -> np.ndarray:
    """First-order lag of the columns of x (n, c) with time constant tau in s, settled at the start."""
    return _uneven_lag(x, tau, tau)


@of_air(critical=(0.2, 0.45), supply=(1.6, 3.0), growth=(0.3, 1.5), size=(0.02, 4.0))
def fill_orifice(w: World, critical: float, supply: float, growth: float, size: float) -> None:
    """Air passes an orifice, choked or subsonic, into a chamber that grows as it fills.

    `size`: s to fill the chamber with the valve full open; `supply` gauge pressure over the top one. Source:
    ISO 6358-1:2013; Beater, Pneumatic Drives (2007) ch. 4.
    """
    w.air = _orifice(w.air, AMBIENT_KPA / w.body.top_kpa, critical, supply, growth, size)


@njit(cache=True)
def _flow(up, down, b):
    """Mass flow per conductance, ISO 6358: up- and downstream absolute pressures, critical ratio b."""
    ratio = down / up
    if ratio >= 1.0:
        return 0.0
    if ratio <= b:
        return up
    return up * math.sqrt(1.0 - ((ratio - b) / (1.0 - b)) ** 2)


@flows
def _orifice(wanted, out, ambient, b, supply, growth, fill):
    # conductance such that a chamber at ambient pressure takes the top pressure's air in the time `fill`
    c = (1.0 + growth * (ambient + 1.0)) / (fill * _flow(ambient + supply, ambient, b))
    parts = 4
    x = wanted[0]
    for i in range(len(wanted)):
        for _ in range(parts):
            u = min(max(12.0 * (wanted[i] - x), -1.0), 1.0)
            if u > 0:
                q = c * u * _flow(ambient + supply, ambient + x, b)
            else:
                q = c * u * _flow(ambient + x, ambient, b) if x > 0 else 0.0
            room = 1.0 + growth * x + growth * (ambient + x)
            x += min(max(DT_S / parts * q / room, -abs(wanted[i] - x)), abs(wanted[i] - x))
        out[i] = x


@of_air(size=(0.05, 6.0))
def valve_slew(w: World, size: float) -> None:
    """The proportional valve opens no faster than its slew limit, so pressure follows in ramps.

    `size`: s from zero to the top pressure. Source: Festo VPPM data sheet (rise of the set pressure); Rao and
    Bone, IEEE T. Control Syst. 16 (2008).
    """
    w.air = _slew(w.air, DT_S / size)


@flows
def _slew(x, out, most):
    y = x[0]
    for i in range(len(x)):
        y += min(max(x[i] - y, -most), most)
        out[i] = y


@of_air(damping=(0.08, 0.5), size=(0.05, 3.0))
def line_second_order(w: World, damping: float, size: float) -> None:
    """Air in a long tube with a volume behind it swings (second order).

    `size`: period of the swing, s. The gauge sits at the valve. Source: Richer and Hurmuzlu, ASME J. Dyn.
    Syst. Meas. Control 122 (2000) 416; Bergh and Tijdeman, NLR (1965).
    """
    w.at_gauge = w.air
    w.air = swing(w.air, 2 * np.pi / size, damping)


@flows
def swing(x, out, omega, damping):
    """Second-order answer to the columns of x (n, c), settled at the start; omega in rad/s."""
    parts = 4
    h = DT_S / parts
    y, v = x[0], 0.0
    for i in range(len(x)):
        for _ in range(parts):
            v = (v + h * omega**2 * (x[i] - y)) / (1.0 + 2 * h * damping * omega)
            y += h * v
        out[i] = y


@of_air(power=(1.3, 3.0), lag_s=(0.015, 0.04), size=(0.005, 0.4))
def leak(w: World, power: float, lag_s: float, size: float) -> None:
    """A leak draws more the higher the pressure is, against the regulator's finite flow.

    `size`: share of the top pressure lost there. Source: Beater, Pneumatic Drives (2007) ch. 4 and 5 (leakage
    of seals).
    """
    w.air = _leak(w.air, power, lag_s, size)


@flows
def _leak(u, out, power, lag_s, size):
    x = u[0]
    for i in range(len(u)):
        x += DT_S / lag_s * (u[i] - x - size * max(x, 0.0) ** power)
        out[i] = x


@of_air(pace=(0.3, 1.5), size=(0.01, 0.25))
def hunting(w: World, pace: float, size: float) -> None:
    """The on-off regulator never settles: pressure hunts about the command in a limit cycle.

    `size`: half the band, share of the top pressure; `pace`: share per s at which it fills or vents. Source:
    van Varseveld and Bone, IEEE/ASME T. Mechatronics 2 (1997) 195.
    """
    w.air = _hunting(w.air, size, pace)


@flows
def _hunting(u, out, band, pace):
    x, way = 0.0, 1.0
    for i in range(len(u)):
        if abs(u[i] - x) > 2 * band:  # far away the servo loop works
            x += min(max(u[i] - x, -0.15), 0.15)
        elif x > u[i] + band * (1.0 + 0.2 * u[i]):
            way = -1.0
        elif x < u[i] - band:
            way = 1.0
        x = max(x + way * pace * (1.0 if way > 0 else 0.4 + 0.6 * x) * DT_S, 0.0)
        if u[i] < 0.02:
            x = min(x, u[i])  # it vents fully and shuts off
        out[i] = x


@of_air(recover_s=(2.0, 12.0), size=(0.02, 0.8))
def supply_sag(w: World, recover_s: float, size: float) -> None:
    """The supply sags while air is drawn, and recovers slowly through its own regulator.

    `size`: share lost by filling all chambers once from zero to the top. Source: Beater, Pneumatic Drives
    (2007) ch. 3 (supply characteristic of regulators).
    """
    used = np.diff(w.air, axis=0, prepend=w.air[:1]).clip(0).sum(1)
    keep = math.exp(-DT_S / recover_s)
    w.air = w.air / (1 + size * lfilter([1.0], [1.0, -keep], used))[:, None]


@of_air(cool_s=(0.4, 4.0), size=(0.02, 0.4))
def gas_heat(w: World, cool_s: float, size: float) -> None:
    """Filled fast, the air warms and then cools at the wall, so pressure overshoots and falls back.

    `size`: overshoot over a step; at most 0.4 (adiabatic). Source: Carneiro and de Almeida, Proc. IMechE I
    221 (2007): heat transfer of air in cylinders.
    """
    w.air = w.air + size * (w.air - lag(w.air, cool_s))


@of_air(fill_share=(0.1, 0.4), size=(0.02, 5.0))
def vent_slow(w: World, fill_share: float, size: float) -> None:
    """Venting through a clogged silencer is slower than filling.

    `size`: time constant of venting, s; filling takes `fill_share` of it. Source: Joshi and Paik, Soft
    Robotics 8 (2021): in- and deflation through supply lines.
    """
    w.air = _uneven_lag(w.air, size * fill_share, size)


@of_air(kink=(0.35, 0.65), size=(0.02, 20.0))
def tube_kink(w: World, kink: float, size: float) -> None:
    """Bent beyond an angle the supply tube kinks, and air passes slowly until it opens again.

    `size`: time constant while kinked, s; kinked above the share `kink` of the top bend. Source: Brazier,
    Proc. R. Soc. A 116 (1927) 104: kinking of bent tubes.
    """
    w.air = _kinked(w.air, kink, size)


@flows
def _kinked(u, out, kink, slow):
    x, shut = u[0], False
    for i in range(len(u)):
        shut = x > (kink - 0.08 if shut else kink)
        x += (1.0 - math.exp(-DT_S / (slow if shut else 0.005))) * (u[i] - x)
        out[i] = x


of_command = partial(effect, "command")


@of_command(size=(0.01, 0.8))
def dead_time(w: World, size: float) -> None:
    """Commands reach the regulator late (bus and valve driver).

    `size`: delay in s. Source: Nilsson, Real-time control systems with delays, thesis, Lund (1998).
    """
    k = seconds(size)
    w.sent = np.concatenate([np.zeros((k, w.sent.shape[1])), w.sent[:-k]])


@of_command(settle=(0.05, 0.5), size=(0.01, 0.25))
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


@of_command(size=(0.003, 0.12))
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


@of_command(way=(-1.0, 1.0), size=(0.005, 0.15))
def regulator_bow(w: World, way: float, size: float) -> None:
    """The regulator's characteristic is bowed between its end points.

    `size`: most it is off, at half the top pressure; upwards where `way` is positive. Source: SMC ITV series
    catalogue (linearity error).
    """
    w.sent = w.sent + np.where(way > 0, 1, -1) * size * 4 * w.sent * (1 - w.sent)


@of_command(size=(0.01, 0.3))
def coarse_steps(w: World, size: float) -> None:
    """The converter in front of the valve knows few steps.

    `size`: one step, share of the top pressure. Source: Widrow and Kollar, Quantization Noise (2008).
    """
    w.sent = np.round(w.sent / size) * size


@of_command(minutes=(1.5, 5.0), size=(0.02, 0.5))
def regulator_warm_up(w: World, minutes: float, size: float) -> None:
    """The regulator delivers less while it warms up after it was switched on.

    `size`: share that is missing at first. Source: SMC ITV series catalogue (temperature characteristic).
    """
    w.sent = w.sent * (1 - size * np.exp(-w.time_s / (60 * minutes)))[:, None]


@of_command(jump=(0.1, 0.6), size=(0.01, 0.25))
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


@of_command(per_minute=(4.0, 12.0), size=(0.03, 3.0))
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
