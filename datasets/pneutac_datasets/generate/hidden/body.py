"""Hidden behaviour of the rubber and of what hangs on it."""

import numpy as np
from numba import njit

from pneutac_datasets.generate.hidden.foreign import foreign

GRAVITY = 9.81


@foreign("creep", "spectrum of twelve retardation times", "body", nominal=0.2, largest=1.5)
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


@foreign("cyclic_softening", "power law of the largest drive so far and of the work done", "body",
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


@foreign("thermal", "Arrhenius law of the modulus", "body", nominal=2.0, largest=20.0)
def arrhenius(drive, bench, size, rng):
    """The modulus falls with exp(B / T); B in thousand kelvin."""
    kelvin = bench.temperature_c + 273.15
    return drive * np.exp(1000 * size * (1 / (21 + 273.15) - 1 / kelvin))


@foreign("gravity", "weight spread along every link", "load", nominal=0.05, largest=1.0)
def distributed_weight(q, bench, size, rng):
    """`size` kg spread along the links, thicker at the base; ten points of each link pull on the joints."""
    joints = bench.joint_positions_m
    ends = np.append(joints, bench.base["length_mm"] / 1000)
    taper = rng.uniform(0.0, 0.5)
    arc = np.concatenate([np.linspace(a, b, 21)[1::2] for a, b in zip(ends[:-1], ends[1:], strict=True)])
    mass = 1 - taper * arc / ends[-1]
    mass *= size / mass.sum()
    return _torque(q, bench, arc, mass)


@foreign("payload", "lump hung below the tip", "load", nominal=1.0, largest=20.0)
def hung_payload(q, bench, size, rng):
    """The mass on record pulls at a hook beyond the tip, `size` times what the scale said."""
    arc = np.array([bench.base["length_mm"] / 1000 * rng.uniform(1.0, 1.1)])
    unit = _torque(q, bench, arc, np.array([1.0]))
    return unit * (size * bench.payload_g[bench.logged] / 1000)[:, None]


def _torque(q, bench, arc, mass):
    """Moment (m, 4), N m, of point masses at arc lengths (k,) about each joint, by virtual work."""
    joints = bench.joint_positions_m
    heading = np.cumsum(q, axis=1)
    c, s = np.cos(heading), np.sin(heading)
    ends = np.append(joints, np.inf)
    g = GRAVITY * bench.gravity[bench.logged]
    torque = np.zeros_like(q)
    # x, z of each joint, then of each mass as joint + rest of its link
    px = np.concatenate(
        [np.full((len(q), 1), joints[0]), joints[0] + np.cumsum(c[:, :-1] * np.diff(joints), 1)], 1
    )
    pz = np.concatenate([np.zeros((len(q), 1)), np.cumsum(s[:, :-1] * np.diff(joints), 1)], 1)
    for a, m in zip(arc, mass, strict=True):
        link = int(np.searchsorted(ends, a, side="right")) - 1
        x = px[:, link] + (a - joints[link]) * c[:, link]
        z = pz[:, link] + (a - joints[link]) * s[:, link]
        for n in range(link + 1):
            # turning joint n by +dq moves the mass by dq (-(z - pz), x - px)
            torque[:, n] += m * (-(z - pz[:, n]) * g[:, 0] + (x - px[:, n]) * g[:, 2])
    return torque
