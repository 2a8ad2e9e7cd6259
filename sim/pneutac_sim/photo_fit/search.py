"""CMA-ES (Hansen and Ostermeier 2001) over a body's parameters, a whole generation at a time, resumable.

How well photographs identify each parameter.
"""

import hashlib
import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.files import write_json
from pneutac_sim.photo_fit.coarse import Coarse, thin
from pneutac_sim.photo_fit.equilibria import BodyParameters
from pneutac_sim.photo_fit.objective import Objective

POPULATION = 7
EVALUATIONS = 84
FINEST = 30.0  # by which the first steps are shorter along what silhouettes determine best
OUTSIDE = 1.0  # objective that a candidate pays for each first step beyond a bound, squared


@dataclass(frozen=True)
class SearchRecord:
    """Where a search keeps what it has tried, so that it can go on from there."""

    # of all candidates and their objectives, written after each generation; None for nowhere
    file: Path | None = None
    key: str = ""  # what the objective depends on; a file of another key is restarted


@dataclass(frozen=True)
class Search:
    """All that a search has tried."""

    x: np.ndarray  # (P,) the best candidate, coordinates
    objective: float  # its
    tried: np.ndarray  # (n, P) candidates in the order of evaluation, coordinates
    objectives: np.ndarray  # (n,)
    resumed: int  # how many of them came from the file


def search(
    objective: Callable[[np.ndarray], np.ndarray],
    parameters: BodyParameters,
    start: Coarse,
    evaluations: int = EVALUATIONS,
    seed: int = 0,
    record: SearchRecord = SearchRecord(),
    progress: Callable[[int, np.ndarray, float], None] = lambda done, best, value: None,
) -> Search:
    """Minimises an objective, (K, P) coordinates to (K,), from a warm start; the seed decides all candidates.

    Where the record's file has the same key, seed and start, its generations are replayed instead of
    evaluated, after which the search goes on as if it had never stopped. Evaluations are rounded up to whole
    generations; `progress` is called after each with those so far, the best candidate and its value.

    Raises InputError: there is no whole generation, or the objective is no number.
    """
    if evaluations < POPULATION:
        raise InputError(f"evaluations={evaluations} must be at least one generation, {POPULATION}.")
    axes = first_axes(parameters, start.hessian)
    strategy = _strategy(len(parameters), seed)
    key = hashlib.sha256(repr((record.key, seed, POPULATION, parameters.names)).encode()).hexdigest()
    stored = _read(record.file, key)
    tried, values, resumed = [], [], 0
    while len(values) < evaluations:
        z = np.array(strategy.ask())
        if not values:
            z[0] = 0.0  # the warm start itself
        wanted = start.x + z @ axes.T  # z ~ N(0, sigma^2 C); beyond a bound a candidate pays
        x = np.clip(wanted, parameters.lower, parameters.upper)
        old = stored[len(values) : len(values) + POPULATION]
        if len(old) == POPULATION and np.allclose([o["x"] for o in old], x, rtol=1e-9, atol=1e-12):
            found, resumed = np.array([o["objective"] for o in old]), resumed + POPULATION
        else:
            stored, found = [], np.asarray(objective(x), float)
        if not np.isfinite(found).all():
            raise InputError(
                "The objective is not a finite number; check masks and cameras of the recording."
            )
        strategy.tell(list(z), found + OUTSIDE * np.square((wanted - x) / parameters.step).sum(1))
        tried += list(x)
        values += found.tolist()
        _write(record.file, key, tried, values)
        best = int(np.argmin(values))
        progress(len(values), tried[best], values[best])
    return Search(tried[best], values[best], np.array(tried), np.array(values), resumed)


def first_axes(parameters: BodyParameters, hessian: np.ndarray) -> np.ndarray:
    """(P, P) square root A of the first covariance A A^T, by the silhouettes' Hessian (P, P).

    No parameter's standard deviation exceeds its first step; along what silhouettes determine best, where the
    warm start is already near, it is `FINEST` times less.
    """
    scaled = hessian * np.outer(parameters.step, parameters.step)
    value, vector = np.linalg.eigh(scaled)
    share = value.clip(0) / max(value[-1], 1e-300)
    return parameters.step[:, None] * vector / np.sqrt(1 + (FINEST**2 - 1) * share)


def _strategy(size: int, seed: int):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it misses a library for plots
        import cma
    rng = np.random.default_rng(seed)
    return cma.CMAEvolutionStrategy(
        np.zeros(size),
        1.0,
        {
            "popsize": POPULATION,
            "seed": np.nan,  # its own generator would be NumPy's global one
            "randn": lambda *shape: rng.standard_normal(shape),
            "verbose": -9,
        },
    )


def _read(file: Path | None, key: str) -> list[dict]:
    if file is None or not file.is_file():
        return []
    try:
        stored = json.loads(file.read_text())
        rows = stored["evaluations"] if stored["key"] == key else []
        return [{"x": np.array(r["x"], float), "objective": float(r["objective"])} for r in rows]
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"{file} is no record of a search ({e!r}); delete it to start again.") from e


def _write(file: Path | None, key: str, tried: list, values: list) -> None:
    if file is None:
        return
    rows = [{"x": x.tolist(), "objective": v} for x, v in zip(tried, values, strict=True)]
    write_json(file, {"key": key, "evaluations": rows})


BLUR_PX = 2.0
BLOCK = 32  # thinned pixels along an edge that count as one observation
MOVE = 0.5  # of a first step, for differences
LATTICE = 0.05  # of the particles' spacing, by which surfaces of one body on different lattices differ
TELLING = 0.1  # of the prior's standard deviation: where more is left, the parameter counts as not identified


@dataclass(frozen=True)
class Posterior:
    """Of P parameters."""

    sd: np.ndarray  # (P,) posterior standard deviation, coordinates
    ci95: dict[str, tuple[float, float]]  # name to interval, physical values, inside the bounds
    not_identified: list[str]  # names of those whose posterior is not ten times narrower than their bounds


def confidence(objective: Objective, x: np.ndarray) -> Posterior:
    """Posterior of the parameters at the optimum x (P,), from how silhouettes move with each.

    Linearised: residual r is blurred coverage less mask, J its derivative by central differences through all
    of material points and renderer. Pixels of a block err together, so information is Godambe's H M^-1 H with
    H = J^T J, M = sum over blocks of (J_b^T r_b)(J_b^T r_b)^T. What is wrong with the body's shape is so in
    all photographs: n of them have no more information on it than one, and M counts n times. So is what the
    lattice leaves open, by which the outline in a block is shifted along either axis: it adds to M. The
    uniform prior between the bounds adds the inverse of its variance.
    """
    parameters = objective.equilibria.parameters
    n = len(parameters)
    step = MOVE * parameters.step
    ends = [np.clip(x + s * np.diag(step), parameters.lower, parameters.upper) for s in (1, -1)]
    bodies = objective.equilibria.solve(np.concatenate([x[None], *ends]))
    surfaces = [objective.surface(*body) for body in zip(bodies.positions, bodies.gradients, strict=True)]
    width = np.diag(ends[0] - ends[1])
    H, M = np.zeros((n, n)), np.zeros((n, n))
    for p in objective.photographs:
        mask = p.mask.astype(np.float32)
        pictures = np.stack(
            [thin(objective.outline.coverage(at[p.state], p.camera) - mask, BLUR_PX) for at in surfaces]
        ).astype(float)
        J = (pictures[1 : n + 1] - pictures[n + 1 :]) / width[:, None, None]
        H += np.einsum("ihw,jhw->ij", J, J)
        depth = p.camera.project(bodies.positions[0, p.state])[1].mean()
        open_px = LATTICE * objective.equilibria.body.spacing_m * p.camera.intrinsics[0, 0] / depth
        shifts = (open_px * thin(slope, BLUR_PX) for slope in np.gradient(mask))
        for residual in (pictures[0], *shifts):
            blocks = _blocks(J * residual)
            M += blocks @ blocks.T
    scale = parameters.prior_sd
    H, M = H * np.outer(scale, scale), M * np.outer(scale, scale)
    M *= len(objective.photographs)
    # No photograph is known better than to a thousandth of a pixel's coverage.
    M += 1e-6 * H + 1e-12 * np.trace(H) / n * np.eye(n)
    # Godambe: H M^-1 H, plus the prior's inverse variance, 1 in these units
    information = H @ np.linalg.solve(M, H)
    sd = scale * np.sqrt(np.diag(np.linalg.inv(information + np.eye(n))))
    low, high = (np.clip(x + s * 1.96 * sd, parameters.lower, parameters.upper) for s in (-1, 1))
    ends = zip(parameters.values(low), parameters.values(high), strict=True)
    ci95 = {name: (float(a), float(b)) for name, (a, b) in zip(parameters.names, ends, strict=True)}
    unclear = [name for name, a, b in zip(parameters.names, sd, scale, strict=True) if a > TELLING * b]
    return Posterior(sd, ci95, unclear)


def _blocks(pictures: np.ndarray) -> np.ndarray:
    """(n, blocks) sums over the blocks of (n, h, w) pictures."""
    n, h, w = pictures.shape
    whole = np.pad(pictures, ((0, 0), (0, -h % BLOCK), (0, -w % BLOCK)))
    return whole.reshape(n, -(-h // BLOCK), BLOCK, -(-w // BLOCK), BLOCK).sum((2, 4)).reshape(n, -1)
