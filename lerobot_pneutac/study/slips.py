"""A marker that slips once on the body: from a moment on, everything is seen elsewhere by the same distance.

No device does that: what its pressure history moves comes with the pressure or fades, and is not the same at
each pressure. So a slip is the moment at which a residual jumps between two samples by just the distance by
which, later and in every further trial, the whole rest of the recording is shifted. Where the body itself
moves farther between these samples, a residual jumps by whatever the model does not know yet.
"""

import numpy as np

NEAR, LEAST_NEAR = 4, 2  # samples on each side, in the same trial, that tell a jump: most and least
LEAST = 4.0  # times the noise: the least jump that is looked into
ALIKE = 0.35  # share by which the jump and the lasting shift may differ
ENDS = 20  # samples at both ends of a recording where nothing lasts


def find_slip(
    residual: np.ndarray,
    predicted: np.ndarray,
    trial: np.ndarray,
    rows: np.ndarray,
    jacobian: np.ndarray,
    noise: float,
) -> tuple[int, np.ndarray] | None:
    """Where the measured pose slips, and by how much.

    Args:
        residual: (n, k) measured - predicted, all samples.
        predicted: (n, k).
        trial: (n,) number of each sample's trial, each in one piece.
        rows: (m,) samples by which it may be judged.
        jacobian: (m k, F) of the prediction at these rows, by all that a refit could move.
        noise: of one sample over all k outputs, in the residual's unit.

    Returns:
        The first row after the slip and the shift (k,) in the residual's unit; None where there is none.
    """
    n, k = residual.shape
    begin = np.flatnonzero(np.r_[True, trial[1:] != trial[:-1]])
    piece = np.searchsorted(begin, np.arange(n), side="right") - 1
    first, last = begin[piece], np.r_[begin[1:], n][piece] - 1
    jump, move = np.zeros((n, k)), np.zeros((n, k))
    for i in range(ENDS, n - ENDS):
        before, after = slice(max(i - NEAR, first[i]), i), slice(i, min(i + NEAR, last[i] + 1))
        if min(before.stop - before.start, after.stop - after.start) < LEAST_NEAR:
            continue  # between trials a payload may change
        jump[i] = residual[after].mean(axis=0) - residual[before].mean(axis=0)
        move[i] = predicted[after].mean(axis=0) - predicted[before].mean(axis=0)
    size = np.linalg.norm(jump, axis=1)
    size[np.linalg.norm(move, axis=1) > size] = 0.0
    best, gain = None, 0.0
    Q = np.linalg.qr(jacobian / (np.linalg.norm(jacobian, axis=0) + 1e-12))[0]
    r = residual[rows].ravel()
    r = r - Q @ (Q.T @ r)
    for i in np.argsort(-size)[:200]:
        if size[i] < LEAST * noise or size[i] < size[max(i - NEAR, 0) : i + NEAR].max():
            continue
        begin_near, end_near = max(i - NEAR, first[i]), min(i + NEAR, last[i] + 1)
        if not _sudden(residual[begin_near:end_near], i - begin_near):
            continue
        step = np.kron((rows >= i)[:, None], np.eye(k))
        step = step - Q @ (Q.T @ step)
        shift, *_ = np.linalg.lstsq(step, r, rcond=None)
        removed = float(r @ r - ((r - step @ shift) ** 2).sum())
        if removed > gain and np.linalg.norm(shift - jump[i]) < ALIKE * np.linalg.norm(shift):
            best, gain = (int(i), shift), removed
    return best


def _sudden(near: np.ndarray, at: int) -> bool:
    """Whether samples (m, k) jump at one of them rather than move there: a step fits better than a line."""
    left = []
    for shape in (np.arange(len(near)) >= at, np.arange(len(near))):
        design = np.stack([np.ones(len(near)), shape], axis=1).astype(float)
        left.append(((near - design @ np.linalg.lstsq(design, near, rcond=None)[0]) ** 2).sum())
    return bool(left[0] < left[1])
