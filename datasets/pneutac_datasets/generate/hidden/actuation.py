"""Hidden actuation: what the pressure becomes before it bends the finger; pressure in, drive out, kPa."""

import numpy as np
from numba import njit

from pneutac_datasets.generate.hidden.foreign import foreign


@foreign("gain_saturation", "arctangent of the pressure", "drive", nominal=0.6, largest=1.5)
def arctangent(pressure, bench, size, rng):
    """Bending levels off as the chamber wall meets its fibres."""
    a = np.pi / 2 * size / bench.top
    return np.arctan(a * pressure) / a


@foreign(
    "stiffening",
    "exponential in the pressure",
    "drive",
    accepts=("stiffening", "gain_saturation"),
    nominal=0.6,
    largest=2.0,
)
def exponential(pressure, bench, size, rng):
    """Either sign: a wall that thins bends ever more, a wall that locks ever less."""
    a = size * (1 if rng.random() < 0.5 else -1) / bench.top
    return np.expm1(a * pressure) / a


@foreign("hysteresis", "Bouc-Wen", "drive", nominal=0.1, largest=0.8)
def bouc_wen(pressure, bench, size, rng):
    """Normalised Bouc-Wen loop (Ismail et al. 2009); the bend lags the pressure both ways."""
    yield_kpa = bench.top * rng.uniform(0.1, 0.3)
    z = _bouc_wen(pressure, 1 / yield_kpa, rng.uniform(0.6, 0.95), rng.uniform(1.0, 1.8))
    return pressure - size * bench.top * z


@njit(cache=True)
def _bouc_wen(p, rho, sigma, n):
    z = np.zeros_like(p)
    state = 0.0  # lives on from trial to trial: time alone does not change it
    for i in range(1, len(p)):
        pieces = 1 + int(20 * rho * abs(p[i] - p[i - 1]))  # a pressure step crosses the whole loop
        d = (p[i] - p[i - 1]) / pieces
        for _ in range(pieces):
            a = abs(state) ** (n - 1)
            state += rho * (d - sigma * abs(d) * a * state + (sigma - 1) * d * a * abs(state))
            state = min(1.0, max(-1.0, state))
        z[i] = state
    return z


@foreign(
    "friction", "LuGre bristles with stick-slip", "drive", accepts=("friction",), nominal=0.05, largest=0.5
)
def lugre(pressure, bench, size, rng):
    """Balance of pressure, spring, damper and a bristle that sticks (Canudas de Wit et al. 1995)."""
    coulomb = size * bench.top
    stiction = coulomb * rng.uniform(1.05, 1.4)
    speed = bench.top * rng.uniform(0.01, 0.05)
    return _lugre(pressure, bench.dt, coulomb, stiction, speed, 0.004 * bench.top)


@njit(cache=True)
def _lugre(p, dt, coulomb, stiction, speed, reach):
    sub = 20
    h = dt / sub
    damping = 0.002  # s: kPa of resistance per kPa/s of drive
    sigma = stiction / reach
    q, z = p[0], 0.0
    out = np.empty_like(p)
    for i in range(len(p)):
        for _ in range(sub):
            # the bristle's spring is stepped implicitly: it is the stiff part
            v = (p[i] - q - sigma * z) / (damping + h * (1 + sigma))
            g = coulomb + (stiction - coulomb) * np.exp(-((v / speed) ** 2))
            z = (z + h * v) / (1 + h * sigma * abs(v) / g)
            q += h * v
        out[i] = q
    return out
