"""How long a device rested before each run, where the log does not have it: as the run's own poses show it.

What a body remembers goes on from the run before, and a drift with the session's time. A pause is one number
a run, fitted to the poses of that run, as instants are to the rows after steps (`instants`): all runs at once
on the grid `GRID_S`, then each by smaller and smaller factors. For a memory that is the pause, since those
before earlier runs hardly matter; where nothing but the clock goes on, it is the sum of all pauses so far.
"""

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.instants import COST
from pneutac_sim.finger.pipeline import Pipeline

RESTED_S = 1e4  # a pause at zero pressure after which everything has rested
GRID_S = np.r_[0.0, np.geomspace(1.0, 400.0, 9), RESTED_S]
_FACTORS = 2.0 ** np.array([0.5, -0.5, 0.5, -0.5, 0.25, -0.25, 0.12, -0.12])


def unknown_pauses(recording) -> np.ndarray:
    """Indices of the first samples of runs before which the pause is not stated; never the first run."""
    trial = np.asarray(recording.samples["trial"])
    first = np.flatnonzero(trial[1:] != trial[:-1]) + 1
    stated = getattr(recording, "meta", {}).get("trials", {})
    known = {k for k, how in stated.items() if how.get("start") == "rested" or "pause_s" in how}
    return first[np.array([str(trial[i]) not in known for i in first], dtype=bool)]


def goes_on(pipeline: Pipeline) -> bool:
    """Whether what a model does in a run depends on how long the pause before it was."""
    clocked = any("session_time_s" in e.columns for e in pipeline.effects)
    return clocked or any(link.remembers for link in pipeline.chain)


def pauses_read(recording, data: BodyData) -> np.ndarray:
    """(k,) s at zero pressure before the runs of `unknown_pauses`, as `data` was read with finite ones."""
    return data.inputs.dt_s[data.inputs.rows[unknown_pauses(recording)] - 1]


def pauses(
    recording, data: BodyData, rows: np.ndarray, pipeline: Pipeline, theta: np.ndarray
) -> tuple[float, ...] | None:
    """Seconds at zero pressure before each run (trials,), as a model sees it; the median where not asked for.

    A run keeps the pause that `data` was read with where its own gains no more than fitting it to noise does.

    Args:
        recording: with `.samples`, and `.meta`, where pauses may be stated.
        data: of all samples, read with a finite pause before each run.
        rows: (m,) samples by which it is judged.
        pipeline: of the model.
        theta: (P,) its parameters.

    Returns None where all are stated, or nothing in the model remembers.
    """
    own = unknown_pauses(recording)
    if not len(own) or not goes_on(pipeline):
        return None
    clock_alone = not any(link.remembers for link in pipeline.chain)
    trial = np.asarray(recording.samples["trial"])
    number = np.cumsum(np.r_[True, trial[1:] != trial[:-1]]) - 1
    at, thin = data.inputs.rows[own] - 1, data.thin(rows)

    def of(x: np.ndarray) -> np.ndarray:
        """(k,) pauses, of what is fitted."""
        return np.diff(np.maximum.accumulate(x), prepend=0.0) if clock_alone else x

    def errors(x: np.ndarray) -> np.ndarray:
        """(k,) sums of squares over the rows of these runs."""
        run = pipeline.run(thin.inputs.paused(at, of(x)), theta, until=pipeline.until(thin.columns))
        r = (pipeline.outputs(run, thin.columns) - thin.measured) * thin.scale
        return np.bincount(number[rows], (r**2).sum(axis=1), minlength=number[-1] + 1)[number[own]]

    usual = pauses_read(recording, data)
    each = np.arange(1.0, len(own) + 1) if clock_alone else np.ones(len(own))
    now = errors(np.cumsum(usual) if clock_alone else usual)
    best = each * GRID_S[np.array([errors(s * each) for s in GRID_S]).argmin(axis=0)]
    least = errors(best)
    for factor in _FACTORS:
        tried = errors(factor * best)
        best, least = np.where(tried < least, factor * best, best), np.minimum(tried, least)
    variance = now.sum() / max(np.isin(number[rows], number[own]).sum(), 1)
    found = of(best) if clock_alone else np.where(now - least > COST * variance, best, usual)
    out = np.full(number[-1] + 1, np.median(found))
    out[number[own]] = found
    return tuple(map(float, out))
