"""A black box as an alarm: what it still predicts from the inputs, a model has left on the table.

Ridge regression on products of causal features (lags and plays of the drive, and conditions), fitted on the
same blocks as the model, its stiffness chosen by cross-validation there.
"""

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T

STIFFNESS = (1e0, 1e1, 1e2, 1e3, 1e4, 1e5)
MOST_ROWS = 4000


def share_left(
    residual: np.ndarray, features: np.ndarray, learn: np.ndarray, test: np.ndarray, floor: float
) -> float:
    """Share of the avoidable squared error on test rows that a black box removes, 0 where nothing was left.

    `residual` (n, k) is the model's, `features` (n, f) are causal signals of any scale, `learn` and `test`
    (n,) masks, and `floor` the noise, root mean square length of the residual's rows.
    """
    left = float((residual[test] ** 2).sum(axis=1).mean()) - floor**2
    if left <= T.BLACK_BOX_EXCESS * floor**2:
        return 0.0
    predicted = predict(residual, features, learn)
    after = float(((residual - predicted)[test] ** 2).sum(axis=1).mean()) - floor**2
    return float(np.clip(1 - max(after, 0.0) / left, 0.0, 1.0))


def predict(target: np.ndarray, features: np.ndarray, learn: np.ndarray) -> np.ndarray:
    """(n, k) what ridge regression on the features makes of a target."""
    rows = np.flatnonzero(learn)
    rows = rows[:: max(1, len(rows) // MOST_ROWS)]
    X = _expanded(features, rows)
    A, Y = X[rows], target[rows]
    fold = np.arange(len(rows)) * 5 // len(rows)  # whole stretches of time
    errors = []
    for stiffness in STIFFNESS:
        total = 0.0
        for k in range(5):
            w = _solve(A[fold != k], Y[fold != k], stiffness)
            total += float(((Y[fold == k] - A[fold == k] @ w) ** 2).sum())
        errors.append(total)
    return X @ _solve(A, Y, STIFFNESS[int(np.argmin(errors))])


def _solve(A: np.ndarray, Y: np.ndarray, stiffness: float) -> np.ndarray:
    return np.linalg.solve(A.T @ A + stiffness * np.eye(A.shape[1]), A.T @ Y)


def _expanded(features: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(n, m) constant, features, and their products, all within what the learning rows have shown."""
    centre, size = features[rows].mean(axis=0), features[rows].std(axis=0)
    F = features[:, size > 1e-9]
    F = (F - centre[size > 1e-9]) / size[size > 1e-9]
    F = np.clip(F, F[rows].min(axis=0), F[rows].max(axis=0))
    i, j = np.triu_indices(F.shape[1])
    return np.concatenate([np.ones((len(F), 1)), F, F[:, i] * F[:, j]], axis=1)
