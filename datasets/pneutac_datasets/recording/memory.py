"""What pressure and its history explain of a motion: a smooth map of a pressure that remembers.

`y = f(u)`, `u = p + sum_j w_j h_j`: f is a polynomial, h_j are lags of the pressure, its largest value yet
and drift. Creep, slow air, softening and a drifting gauge all move the device along the path on which
pressure moves it, and so does this model; a mount that was turned need not.
"""

from itertools import combinations

import numpy as np

from pneutac_datasets.recording.recording import Recording

TIMES_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
STARTS = ("held", "vented", "carried")
WEIGHTS = (-0.5, 2.0)  # of a history besides the pressure itself; creep beyond twice its start is unheard of
RIDGE, DAMPING = 1e-5, 1e-4


def static_columns(u: np.ndarray) -> np.ndarray:
    """(n, m): a constant first, powers up to the fourth, and products of two chambers.

    Pressures or drives `u` (n, chambers) are of the order of 1.
    """
    products = [(u[:, i] * u[:, j])[:, None] for i, j in combinations(range(u.shape[1]), 2)]
    return np.hstack([np.ones((len(u), 1)), u, u**2, u**3, u**4, *products])


def regress(design: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Coefficients (m, k) by ridge regression on standardised columns; the first column is a constant."""
    mean, scale = design[:, 1:].mean(0), design[:, 1:].std(0)
    scale = np.where(scale > 1e-9, scale, np.inf)  # a constant column has no information
    z = (design[:, 1:] - mean) / scale
    slope = np.linalg.solve(z.T @ z + RIDGE * len(z) * np.eye(z.shape[1]), z.T @ (y - y.mean(0)))
    slope /= scale[:, None]
    return np.vstack([y.mean(0) - mean @ slope, slope])


class Memory:
    """A map with memory, fitted a round at a time.

    Of pressures (n, chambers), of the order of 1, and their `history`; `weight` (j,) is that of each history.
    """

    def __init__(self, p: np.ndarray, past: np.ndarray):
        self._p, self._past = p, past
        self.weight = np.zeros(len(past))

    def round(self, y: np.ndarray, rows: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One step of Gauss and Newton on rows (n,) of what was measured, y (n, k).

        `moves` (n, k, m) may be added to y. Returns the prediction (n, k), also of all other rows, and how
        much of each move to add (m,).
        """
        columns = static_columns(self._drive())
        bend, tiny = regress(columns[rows], y[rows]), 1e-4
        past = [(static_columns(self._drive() + tiny * h) - columns) @ bend / tiny for h in self._past]
        slopes = np.concatenate([np.stack(past, -1), -moves], -1)[rows]
        # the map gives way to weights and moves, so what it takes of them is taken off
        basis = np.linalg.qr(columns[rows])[0]
        slopes = slopes - np.einsum("nb,bkm->nkm", basis, np.einsum("nb,nkm->bkm", basis, slopes))
        a, b = slopes.reshape(-1, slopes.shape[-1]), (y[rows] - columns[rows] @ bend).reshape(-1)
        gram = a.T @ a
        step = np.linalg.solve(gram + np.diag(DAMPING * gram.diagonal() + 1e-9), a.T @ b)
        self.weight = np.clip(self.weight + step[: len(past)], *WEIGHTS)
        columns = static_columns(self._drive())
        y = y + moves @ step[len(past) :]
        return columns @ regress(columns[rows], y[rows]), step[len(past) :]

    def _drive(self) -> np.ndarray:
        return self._p + np.tensordot(self.weight, self._past, 1)


def history(recording: Recording, p: np.ndarray, start: str) -> np.ndarray:
    """(j, n, chambers): lags of the pressure over 0.1 s to minutes, its largest value yet, and drift.

    Trials start `held` at their first pressure for ever, `vented` for ever, or `carried` on from where the
    trial before ended, after its pause where that is known.
    """
    time, begun = recording.column("time_s"), recording.starts
    tau = np.array(TIMES_S)[:, None]
    lags, state = np.empty((len(tau), *p.shape)), np.zeros((len(tau), p.shape[1]))
    for trial, rows in recording.trials().items():
        if start == "carried":
            state = state * np.exp(-(begun[trial].pause_s or 0.0) / tau)
        else:
            state = np.zeros_like(state) + (p[rows.start] if start == "held" else 0.0)
        keep = np.exp(-np.diff(time[rows], prepend=time[rows.start])[:, None, None] / tau)
        for i, k in enumerate(keep, rows.start):
            state = k * state + (1 - k) * p[i]
            lags[:, i] = state
    done = np.linspace(0, 1, len(p))[:, None] + 0 * p
    return np.stack([*lags, np.maximum.accumulate(p), done, done * p])
