"""Hidden behaviour of the rubber: drive in, drive out, kPa."""

import numpy as np
from numba import njit

from pneutac_datasets.generate.hidden.foreign import foreign


@foreign("creep", "spectrum of twelve retardation times", "material", nominal=0.2, largest=1.5)
def spectrum(drive, bench, size, rng):
    """Times from a tenth of a second to five minutes; the weights form a random hump over them."""
    times = np.geomspace(0.1, 300.0, 12) * rng.uniform(0.8, 1.25)
    hump = -0.5 * ((np.log(times) - rng.uniform(np.log(1.0), np.log(40.0))) / rng.uniform(0.8, 1.8)) ** 2
    weights = np.exp(hump)
    weights *= size / weights.sum()
    return _prony(drive, bench.start, bench.dt, times, weights)


@njit(cache=True)
def _prony(u, start, dt, times, weights):
    out = np.empty_like(u)
    state = np.zeros(len(times))
    decay = np.exp(-dt / times)
    for i in range(len(u)):
        if start[i]:
            state[:] = 0.0
        else:
            state = decay * state + (1 - decay) * u[i]
        out[i] = u[i] + (weights * state).sum()
    return out


@foreign("cyclic_softening", "power law of the largest drive so far and of the work done", "material",
         nominal=0.2, largest=1.5)  # fmt: skip
def maximum_history(drive, bench, size, rng):
    """Below the largest drive seen the rubber is softer (Mullins); each cycle adds a little, ever less."""
    return _mullins(drive, size, rng.uniform(1.0, 2.0), bench.top, rng.uniform(6, 15), 0.5)


@njit(cache=True)
def _mullins(u, size, power, top, cycles, share):
    out = np.empty_like(u)
    largest = path = 0.0  # the damage stays from trial to trial
    for i in range(len(u)):
        path += abs(u[i] - u[max(i - 1, 0)])
        largest = max(largest, u[i])
        below = (1 - max(u[i], 0.0) / max(largest, 1e-9)) ** power * min(1.0, largest / top)
        fatigue = 1 - 1 / (1 + path / (2 * top * cycles))
        out[i] = u[i] * (1 + size * ((1 - share) * below + share * fatigue))
    return out


@foreign("thermal", "Arrhenius law of the modulus", "material", nominal=2.0, largest=20.0)
def arrhenius(drive, bench, size, rng):
    """The modulus falls with exp(B / T); B in thousand kelvin."""
    kelvin = bench.temperature_c + 273.15
    return drive * np.exp(1000 * size * (1 / (21 + 273.15) - 1 / kelvin))
