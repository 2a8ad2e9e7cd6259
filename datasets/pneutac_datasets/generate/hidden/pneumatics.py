"""Hidden pneumatics: dead time, filling, flow, leak, gauge."""

import numpy as np
from numba import njit

from pneutac_datasets.generate.hidden.foreign import foreign

ATMOSPHERE_KPA = 101.3


@foreign("dead_time", "a queue whose length wanders", "command", nominal=0.2, largest=1.5, least=0.08)
def queue(command, bench, size, rng):
    """A command waits about `size` seconds, a quarter more or less, changing from second to second."""
    n = len(command)
    knots = np.arange(0, n + 1 / bench.dt, 1 / bench.dt)
    wait = size * (1 + 0.25 * np.interp(np.arange(n), knots, rng.uniform(-1, 1, len(knots))))
    first = np.maximum.accumulate(np.where(bench.start, np.arange(n), 0))
    return np.interp(np.maximum(np.arange(n) - wait / bench.dt, first), np.arange(n), command)


@foreign(
    "valve_lag",
    "ISO 6358 filling and venting through a proportional valve",
    "pressure",
    accepts=("valve_lag", "orifice_flow"),
    nominal=1.0,
    largest=20.0,
    least=0.4,
)
def iso_filling(command, bench, size, rng):
    """The chamber fills from a tank and vents to the room through an orifice with a critical ratio."""
    b, polytropic = rng.uniform(0.2, 0.35), rng.uniform(1.0, 1.3)
    tank = ATMOSPHERE_KPA + bench.top * rng.uniform(1.4, 2.0)
    band = bench.top * rng.uniform(0.15, 0.3)
    # rate at full opening from the tank: the whole range in about half a second at size 1
    rate = polytropic * bench.top / (0.5 * size) / tank
    return _iso(command, bench.start, bench.dt, tank, b, band, rate, rng.uniform(0.6, 0.9))


@njit(cache=True)
def _iso(command, start, dt, tank, b, band, rate, vent):
    sub = 5
    out = np.empty_like(command)
    p = 0.0
    for i in range(len(command)):
        if start[i]:
            p = command[i]
        for _ in range(sub):
            opening = min(1.0, max(-1.0, (command[i] - p) / band))
            if opening >= 0:
                upstream, ratio, gain = tank, (p + ATMOSPHERE_KPA) / tank, 1.0
            else:
                upstream, ratio, gain = p + ATMOSPHERE_KPA, ATMOSPHERE_KPA / (p + ATMOSPHERE_KPA), vent
            psi = 1.0
            if ratio > b:
                psi = np.sqrt(max(0.0, 1 - ((ratio - b) / (1 - b)) ** 2))
            move = rate * gain * opening * upstream * psi * dt / sub
            rest = command[i] - p
            p += move if abs(move) < abs(rest) else rest
        out[i] = p
    return out


@foreign(
    "orifice_flow",
    "turbulent flow through valve and tube in series, two volumes",
    "pressure",
    accepts=("orifice_flow", "valve_lag"),
    nominal=1.0,
    largest=20.0,
    least=0.4,
)
def two_volumes(command, bench, size, rng):
    """Flow goes with the square root of the pressure drop, first into the tube, then into the chamber."""
    share = rng.uniform(0.15, 0.3)
    speed = 2 * np.sqrt(bench.top) / (0.5 * size)
    return _series(command, bench.start, bench.dt, speed, share)


@njit(cache=True)
def _series(command, start, dt, speed, share):
    sub = 10
    tube = chamber = 0.0
    out = np.empty_like(command)
    for i in range(len(command)):
        if start[i]:
            tube = chamber = command[i]
        for _ in range(sub):
            # flows are bounded so that a step never passes the balance of the two sides
            drop = command[i] - tube
            flow_in = np.sign(drop) * min(speed * np.sqrt(abs(drop)) * dt / sub, abs(drop))
            drop = tube - chamber
            flow_out = np.sign(drop) * min(speed * np.sqrt(abs(drop)) * dt / sub, abs(drop) * share)
            tube += flow_in - flow_out / share * 0.5
            chamber += flow_out
        out[i] = chamber
    return out


@foreign(
    "leak",
    "conductance that rises with pressure, while the valve is shut",
    "pressure",
    nominal=0.02,
    largest=0.5,
)
def leak(pressure, bench, size, rng):
    """The valve shuts 0.6 s after the last change; then air leaves through pores that the pressure widens."""
    return _leak(bench.command, pressure, bench.start, bench.dt, size, bench.top * rng.uniform(0.6, 1.5))


@njit(cache=True)
def _leak(command, pressure, start, dt, k, widen):
    out = np.empty_like(pressure)
    p, since = 0.0, 0.0
    for i in range(len(pressure)):
        if start[i]:
            p, since = pressure[i], 0.0
        elif command[i] != command[i - 1]:
            since = 0.0
        since += dt
        if since < 0.6:
            p = pressure[i]
        else:
            p -= k * p * (1 + p / widen) * dt
        out[i] = p
    return out


@foreign("sensor_offset", "warm-up drift of the gauge that the regulator trusts", "gauge", nominal=5.0,
         largest=40.0)  # fmt: skip
def warming_gauge(reading, bench, size, rng):
    """The gauge's zero moves by `size` kPa while it warms up over minutes, and trembles a little."""
    t = np.arange(len(reading)) * bench.dt
    warm = 1 - np.exp(-t / rng.uniform(150, 600))
    warm *= rng.choice([-1.0, 1.0]) / warm[-1]
    tremble = np.cumsum(rng.normal(size=len(t)))
    tremble *= 0.03 / np.abs(tremble).max()
    return reading - size * (warm + tremble)
