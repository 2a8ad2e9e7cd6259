"""Fingerprints: how a missing effect would show in the residual. They suggest, they never decide.

For each effect one contrast, a signal made from pressure, time and conditions alone, is regressed on the
residual after everything linear in pressure was taken out. Blocks of the contrast are shuffled for the chance
level.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from pneutac_datasets.recording.recording import Recording

SHUFFLES = 200


@dataclass
class Fingerprint:
    """How much of the residual one contrast explains.

    Attributes:
        effect: the effect it hints at.
        contrast: what was compared, in words.
        share: of the residual's variance, 0 to 1.
        chance: the share that shuffled blocks reach in one of twenty cases.
        p_value: how often shuffled blocks do as well.
    """

    effect: str
    contrast: str
    share: float
    chance: float
    p_value: float


def fingerprints(
    recording: Recording, residual: np.ndarray, pressure: np.ndarray, seed: int = 0
) -> list[Fingerprint]:
    """All contrasts that the recording's columns allow, the most telling first.

    Args:
        recording: gives time, trials and conditions.
        residual: (n, k) measured minus the twin as it is.
        pressure: (n, channels) kPa that drives the twin: measured where it is known, else commanded.
        seed: of the shuffles.
    """
    p = pressure.mean(1)
    p = p / max(np.abs(p).max(), 1e-9)
    block = recording.blocks()
    y = _without(residual, np.stack([np.ones_like(p), p], 1))
    main = np.linalg.svd(y - y.mean(0), full_matrices=False)[2][0]
    y = y @ main
    rng = np.random.default_rng([seed, 5])
    found = []
    for effect, (words, x) in contrasts(recording, p).items():
        x = _without(x, np.stack([np.ones_like(p), p], 1))
        if (x.std(0) < 1e-9).all():
            continue
        share = _share(y, x)
        chance = np.array([_share(y, _shuffled(x, block, rng)) for _ in range(SHUFFLES)])
        found.append(
            Fingerprint(
                effect,
                words,
                share,
                float(np.quantile(chance, 0.95)),
                float((1 + (chance >= share).sum()) / (1 + SHUFFLES)),
            )
        )
    return sorted(found, key=lambda f: -(f.share - f.chance))


def contrasts(recording: Recording, p: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    """Effect to words and contrast (n, k); `p` (n,) is the pressure over its largest."""
    s = recording.samples
    dt = steps(recording)
    still_s = _since_change(p, dt)
    slow = np.stack([lagged(p, dt, t) - p for t in (3.0, 20.0)], 1)
    loops = np.stack([play(p, dt, r) - p for r in (0.05, 0.2)], 1)
    made = {
        "valve_lag": ("the loop widens with speed", lagged(p, dt, 0.3) - p),
        "dead_time": ("the start of each move is late", lagged(p, dt, 0.08) - p),
        "creep": ("it relaxes for seconds in holds", slow),
        "hysteresis": ("the loop is there at any speed", loops),
        "friction": ("it waits at each reversal", play(p, dt, 0.03) - p),
        "leak": ("it falls back while the valve holds", p * (1 - np.exp(-still_s / 10))),
        "stiffening": ("one curved line in pressure", np.stack([p**2, p**3], 1)),
        "gain_saturation": ("one line that flattens", p**3),
        "cyclic_softening": ("softer below the largest pressure so far and per cycle", _history(p, dt)),
        "sensor_offset": ("it drifts with the time of the session", np.cumsum(np.minimum(dt, 1.0))),
    }  # fmt: skip
    if "temperature_c" in s:
        t = s["temperature_c"].to_numpy(float)
        made["thermal"] = ("it changes with temperature", (t - t.mean()) * p)
    gravity = [c for c in ("gravity_x", "gravity_y", "gravity_z") if c in s]
    if gravity:
        g = s[gravity].to_numpy(float)
        made["gravity"] = ("it depends on how the base is held", np.hstack([g, g * p[:, None]]))
    if "payload_g" in s:
        m = s["payload_g"].to_numpy(float)
        made["payload"] = ("it depends on the mass at the tip", np.stack([m, m * p], 1))
    return {k: (w, x.reshape(len(p), -1)) for k, (w, x) in made.items()}


def steps(recording: Recording) -> np.ndarray:
    """(n,) seconds since the sample before, infinite at the first of a trial."""
    dt = np.r_[np.inf, np.diff(recording.column("time_s"))]
    for rows in recording.trials().values():
        dt[rows.start] = np.inf
    return dt


@njit(cache=True)
def lagged(p, dt, tau):
    """First-order lag of p (n,) with time constant tau, at rest at each infinite dt."""
    out = np.empty_like(p)
    x = p[0]
    for i in range(len(p)):
        x = p[i] if np.isinf(dt[i]) else p[i] + (x - p[i]) * np.exp(-dt[i] / tau)
        out[i] = x
    return out


@njit(cache=True)
def play(p, dt, r):
    """Play operator of radius r, at rest at each infinite dt."""
    out = np.empty_like(p)
    x = p[0]
    for i in range(len(p)):
        x = p[i] if np.isinf(dt[i]) else min(max(x, p[i] - r), p[i] + r)
        out[i] = x
    return out


@njit(cache=True)
def _since_change(p, dt):
    out = np.zeros_like(p)
    for i in range(1, len(p)):
        still = not np.isinf(dt[i]) and abs(p[i] - p[i - 1]) < 1e-3
        out[i] = out[i - 1] + dt[i] if still else 0.0
    return out


@njit(cache=True)
def _history(p, dt):
    """(n, 2): p below its largest so far, and p times the path travelled, which saturates."""
    out = np.zeros((len(p), 2))
    largest, path = 0.0, 0.0
    for i in range(len(p)):
        if np.isinf(dt[i]):
            largest, path = 0.0, 0.0
        else:
            path += abs(p[i] - p[i - 1])
        largest = max(largest, p[i])
        out[i, 0] = p[i] * (largest - p[i])
        out[i, 1] = p[i] * path / (path + 10.0)
    return out


def _without(y: np.ndarray, basis: np.ndarray) -> np.ndarray:
    return y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]


def _share(y: np.ndarray, x: np.ndarray) -> float:
    """Share of the variance of y (n,) that x (n, k) explains."""
    gram = x.T @ x
    gram[np.diag_indices_from(gram)] += 1e-9 * np.trace(gram)
    b = x.T @ y
    return float(b @ np.linalg.solve(gram, b) / max((y @ y), 1e-30))


def _shuffled(x: np.ndarray, block: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The contrast with its blocks in another order, which keeps its smoothness in time."""
    order = rng.permutation(block.max() + 1)
    edges = np.r_[np.flatnonzero(np.diff(block, prepend=-1)), len(block)]
    pieces = [x[a:b] for a, b in zip(edges[:-1], edges[1:], strict=True)]
    return (
        np.concatenate([pieces[i] for i in order])
        if len(pieces) == len(order)
        else np.roll(x, order[0] + 1, 0)
    )
