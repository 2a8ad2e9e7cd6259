"""Disturbances that no effect of a library describes: the right answer to these is `unknown`."""

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from pneutac_datasets.generate.hidden.foreign import foreign


@foreign("disturbance_walking_scale", "random walk of the tracker's scale", "marker", (), 0.05, 0.5)
def walking_scale(tip, bench, size, rng):
    """The tracker's scale wanders up and down by `size` over the session."""
    walk = gaussian_filter1d(rng.normal(size=len(tip)), 200)
    return tip * (1 + size * walk / walk.std())[:, None]


@foreign(
    "disturbance_marker_slip", "the marker slips along the skin at random times", "marker", (), 2.0, 60.0
)
def marker_slip(tip, bench, size, rng):
    """Every half minute or so the marker moves on by about `size` mm, in any direction, and stays."""
    at = np.flatnonzero(rng.random(len(tip)) < np.median(np.diff(bench.time_s)) / 25)
    jumps = np.zeros_like(tip)
    jumps[at] = rng.normal(size=(len(at), 3))
    track = np.cumsum(jumps, axis=0)
    return tip + size * (track - track.mean(0)) / max(track.std(), 1e-9)


@foreign("disturbance_vibration", "a machine nearby shakes it at a fixed rate", "drive", (), 0.05, 1.0)
def vibration(drive, bench, size, rng):
    """A force that comes and goes with two rates, blind to the pressure."""
    t = np.arange(len(drive)) * bench.dt
    a, b = rng.uniform(0.15, 0.5), rng.uniform(0.6, 2.5)
    swell = 0.6 + 0.4 * np.sin(2 * np.pi * t / rng.uniform(40, 90))
    return drive + size * bench.top * swell * (
        np.sin(2 * np.pi * a * t + rng.uniform(0, 6)) + 0.5 * np.sin(2 * np.pi * b * t + rng.uniform(0, 6))
    )


@foreign(
    "disturbance_crosstalk", "another chamber, not on record, is stepped at random", "drive", (), 0.1, 1.0
)
def crosstalk(drive, bench, size, rng):
    """A neighbouring input with its own random levels bends the finger as well."""
    n = int(len(drive) * bench.dt / 8) + 2
    edges = np.sort(rng.uniform(0, len(drive), n)).astype(int)
    level = np.zeros(len(drive))
    level[edges] = np.diff(np.r_[0.0, rng.uniform(0, 1, n)])
    return drive + size * bench.top * gaussian_filter1d(np.cumsum(level), 0.15 / bench.dt)


@foreign("disturbance_base_bumps", "someone leans on the bench now and then", "marker", (), 2.0, 40.0)
def base_bumps(tip, bench, size, rng):
    """For some seconds at a time the base is turned by about `size` degrees, each time another way."""
    hz = 1 / np.median(np.diff(bench.time_s))
    turn = np.zeros_like(tip)
    for _ in range(max(3, int(len(tip) / hz / 20))):
        a = rng.integers(0, len(tip))
        turn[a : a + int(hz * rng.uniform(3, 12))] = rng.normal(size=3)
    turn = gaussian_filter1d(turn, 0.3 * hz, axis=0)
    return Rotation.from_rotvec(np.radians(size) * turn).apply(tip)
