"""Black boxes that learn a target from causal features of one day and predict it on another.

Each takes features (n, f) and target (n, k) of the day that it learns from, features (m, f) of the other day
and a seed, and returns (m, k); what it may choose it chooses by blocks of time of the first day. Features are
held to what the first day has shown.
"""

import importlib.util

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from lerobot_pneutac.diagnosis import black_box

FOLDS = 5
MOST_ROWS = 4000
GP_ROWS, GP_TUNED_ON = 1500, 500
THRESHOLDS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
HIDDEN, EPOCHS, PATIENCE, BATCH = 64, 200, 20, 256
OPERON_SECONDS = 60


def ridge(features, target, others, seed: int) -> np.ndarray:
    """Ridge regression on products of features, see `lerobot_pneutac.diagnosis.black_box`."""
    return _both_days(black_box.predict, features, target, others)


def stlsq(features, target, others, seed: int) -> np.ndarray:
    """Sequentially thresholded least squares on features and their products.

    Brunton, Proctor and Kutz, PNAS 113 (2016) 3932, with delayed and hysteretic features in place of states.
    """
    F, G = _scaled(features, others)
    i, j = np.triu_indices(F.shape[1])
    A, B = (np.concatenate([np.ones((len(x), 1)), x, x[:, i] * x[:, j]], axis=1) for x in (F, G))
    rows = _some(len(A), MOST_ROWS)
    A, Y = A[rows], target[rows]
    fold = np.arange(len(rows)) * FOLDS // len(rows)
    size = Y.std(axis=0) + 1e-12
    errors = []
    for threshold in THRESHOLDS:
        parts = [_sparse(A[fold != k], Y[fold != k], threshold * size) for k in range(FOLDS)]
        errors.append(sum(((Y[fold == k] - A[fold == k] @ w) ** 2).sum() for k, w in enumerate(parts)))
    return B @ _sparse(A, Y, THRESHOLDS[int(np.argmin(errors))] * size)


def _sparse(A: np.ndarray, Y: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    """(m, k) weights; those below the threshold (k,) of their column are zero."""
    out = np.zeros((A.shape[1], Y.shape[1]))
    gram, right = A.T @ A + 1e-3 * len(A) * np.eye(A.shape[1]), A.T @ Y
    for c in range(Y.shape[1]):
        on = np.ones(A.shape[1], bool)
        w = np.zeros(A.shape[1])
        for _ in range(10):
            w[:] = 0.0
            if on.any():
                w[on] = np.linalg.solve(gram[np.ix_(on, on)], right[on, c])
            kept = np.abs(w) >= threshold[c]
            if (kept == on).all():
                break
            on = kept
        out[:, c] = w
    return out


def gaussian_process(features, target, others, seed: int) -> np.ndarray:
    """A Gaussian process with a squared exponential on a subset of the data.

    Rasmussen and Williams, Gaussian Processes for Machine Learning (2006) ch. 2, 5 and 8.3.3.
    """
    F, G = _scaled(features, others)
    out = np.zeros((len(G), target.shape[1]))
    for c in range(target.shape[1]):
        y, mean = target[:, c] - target[:, c].mean(), target[:, c].mean()
        size = y.std() + 1e-12
        few = _some(len(F), GP_TUNED_ON)
        start = [np.log(np.sqrt(F.shape[1])), np.log(0.3)]
        tuned = minimize(
            _evidence, start, (F[few], y[few] / size), method="Nelder-Mead", options={"maxiter": 60}
        )
        length, noise = np.exp(tuned.x)
        rows = _some(len(F), GP_ROWS)
        factor = cho_factor(_kernel(F[rows], F[rows], length) + (noise**2 + 1e-8) * np.eye(len(rows)))
        out[:, c] = mean + _kernel(G, F[rows], length) @ cho_solve(factor, y[rows])
    return out


def _kernel(a: np.ndarray, b: np.ndarray, length: float) -> np.ndarray:
    square = (a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2 * a @ b.T
    return np.exp(-0.5 * np.maximum(square, 0.0) / length**2)


def _evidence(logs, F: np.ndarray, y: np.ndarray) -> float:
    """Minus the logarithm of the marginal likelihood, the process' own size put in at its best."""
    length, noise = np.exp(logs)
    K = _kernel(F, F, length) + (noise**2 + 1e-8) * np.eye(len(F))
    try:
        factor = cho_factor(K, lower=True)
    except np.linalg.LinAlgError:
        return 1e12
    fit = float(y @ cho_solve(factor, y)) / len(y)
    return 0.5 * len(y) * np.log(max(fit, 1e-300)) + float(np.log(np.diag(factor[0])).sum())


def network(features, target, others, seed: int) -> np.ndarray:
    """Two hidden layers, stopped early on the last fifth of the day, by blocks of time."""
    import torch

    F, G = _scaled(features, others)
    mean, size = target.mean(axis=0), target.std(axis=0) + 1e-12
    X, Y, Z = (torch.tensor(a, dtype=torch.float32) for a in (F, (target - mean) / size, G))
    held = torch.tensor(np.arange(len(F)) * 20 // len(F) % FOLDS == FOLDS - 1)
    torch.manual_seed(seed)
    layers = [
        torch.nn.Linear(F.shape[1], HIDDEN),
        torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, HIDDEN),
        torch.nn.Tanh(),
    ]
    net = torch.nn.Sequential(*layers, torch.nn.Linear(HIDDEN, target.shape[1]))
    optimizer = torch.optim.AdamW(net.parameters(), lr=2e-3, weight_decay=1e-2)
    learn, best, waited = torch.nonzero(~held)[:, 0], np.inf, 0
    kept = {k: v.clone() for k, v in net.state_dict().items()}
    for _ in range(EPOCHS):
        for batch in learn[torch.randperm(len(learn))].split(BATCH):
            optimizer.zero_grad()
            ((net(X[batch]) - Y[batch]) ** 2).mean().backward()
            optimizer.step()
        with torch.no_grad():
            error = float(((net(X[held]) - Y[held]) ** 2).mean())
        waited = 0 if error < best else waited + 1
        if error < best:
            best, kept = error, {k: v.clone() for k, v in net.state_dict().items()}
        if waited > PATIENCE:
            break
    net.load_state_dict(kept)
    with torch.no_grad():
        return net(Z).numpy() * size + mean


def symbolic(features, target, others, seed: int) -> np.ndarray | None:
    """Genetic programming by Operon (Burlacu et al., GECCO 2020); None where pyoperon is not installed."""
    if importlib.util.find_spec("pyoperon") is None:
        return None
    from pyoperon.sklearn import SymbolicRegressor

    F, G = _scaled(features, others)
    rows = _some(len(F), MOST_ROWS)
    out = np.zeros((len(G), target.shape[1]))
    for c in range(target.shape[1]):
        found = SymbolicRegressor(
            allowed_symbols="add,sub,mul,aq,tanh,constant,variable", max_length=40, max_time=OPERON_SECONDS,
            n_threads=1, random_state=seed,
        )  # fmt: skip
        out[:, c] = found.fit(F[rows], target[rows, c]).predict(G)
    return out


def _both_days(method, features, target, others) -> np.ndarray:
    """A method that predicts all rows of one table, on the other day's rows."""
    n = len(features)
    table = np.concatenate([features, others])
    padded = np.concatenate([target, np.zeros((len(others), target.shape[1]))])
    return method(padded, table, np.arange(len(table)) < n)[n:]


def _scaled(features: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both with the first's mean 0 and deviation 1, and the others held to the first's range."""
    mean, size = features.mean(axis=0), features.std(axis=0)
    varying = size > 1e-9
    F, G = ((x[:, varying] - mean[varying]) / size[varying] for x in (features, others))
    return F, np.clip(G, F.min(axis=0), F.max(axis=0))


def _some(n: int, most: int) -> np.ndarray:
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))
