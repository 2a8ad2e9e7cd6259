"""CMA-ES (Hansen and Ostermeier 2001) over a body's parameters, a whole generation at a time, resumable.

A first fit is to silhouettes alone: the body bends as its spine does, without material points.

The surface is carried along by the links and drawn, and its coverage is compared with the masks, both
blurred: widely first, so that silhouettes that do not overlap attract each other, then less. Bounded least
squares do the rest, since the difference is smooth in the joint angles. What the links leave out is then
taken from material points at rest at the parameters found, and the last fit repeated. Last come Gauss-Newton
steps with derivatives from material points: those of the links are too wrong to separate the joints.
"""

import hashlib
import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares, lsq_linear

from pneutac_sim.errors import InputError
from pneutac_sim.files import write_json
from pneutac_sim.mpm.devices import BODIES
from pneutac_sim.photo_fit.objective import (
    Bodies,
    BodyParameters,
    Equilibria,
    MaskedPhotograph,
    Objective,
    Outline,
    joint_targets,
)
from pneutac_sim.splat.body import check_photograph
from pneutac_sim.splat.camera import Camera

BLURS = (0.12, 0.03, 0.01)  # standard deviations over the square root of the mask's area times 3
BENDS_RAD = np.linspace(-1.2, 2.4, 7)  # of a whole finger, tried at the lowest and the highest pressure
PARTICLES = 1500
PIXELS = 160  # of a body's length, to which photographs are reduced
LEAST_IOU = 0.4  # of silhouettes; with less in common the photograph is of something else
STEPS = 3  # of Gauss-Newton by material points
SMALL = 0.05  # of the first step, for differences
ROUGH_MOVE = 0.25  # the same by material points, which come to rest within a tolerance


@dataclass(frozen=True)
class Coarse:
    """What silhouettes determine."""

    x: np.ndarray  # (P,) coordinates; the material's are those of the twin
    # (P, P) of half the squared difference at the least blur, coordinates; material's rows are 0
    hessian: np.ndarray


class Skinned:
    """A body's surface that is carried along by its spine's links, at pressures (T, chambers) kPa.

    Candidates differ in `parameters`; `conditions` are what effects of the twin ask for.
    """

    def __init__(
        self,
        parameters: BodyParameters,
        pressures: np.ndarray,
        photographs: list[MaskedPhotograph],
        conditions: dict | None = None,
        device: str = "auto",
    ):
        self.parameters, self.pressures, self.conditions = parameters, pressures, conditions
        self.device = device
        self.photographs = [reduced(p) for p in photographs]
        self.spine = BODIES[parameters.twin.device](parameters.twin, particles=PARTICLES, device=device).spine
        self.outline = Outline(parameters.twin)
        self._left_out = 0.0

    def correct(self, x: np.ndarray) -> Equilibria:
        """Takes what the links leave out from material points at rest at `x` (P,)."""
        self._left_out = 0.0
        rest = Equilibria(self.parameters, x, self.pressures, self.conditions, PARTICLES, self.device)
        self._left_out = self.surfaces(rest, rest.first)[0] - self.positions(x)
        return rest

    def surfaces(self, rest: Equilibria, bodies: Bodies) -> np.ndarray:
        """(K, T, V, 3) m of bodies of material points."""
        follow = self.outline.on(rest.body)
        return np.stack([follow(*b) for b in zip(bodies.positions, bodies.gradients, strict=True)])

    def positions(self, x: np.ndarray) -> np.ndarray:
        """(T, V, 3) m of the surface of one candidate (P,)."""
        twin = self.parameters.twin_at(x)
        q = joint_targets(twin, self.pressures, self.conditions)
        return self.spine.skin(q, self.outline.vertices) + self._left_out

    def coverage(self, at: np.ndarray, photograph: MaskedPhotograph) -> np.ndarray:
        """(H, W) of surfaces at (T, V, 3) m as this reduced photograph's camera sees them."""
        return self.outline.coverage(at[photograph.state], photograph.camera)

    def differences(self, at: np.ndarray, blur: float) -> np.ndarray:
        """Coverage less mask of every photograph, blurred (see `BLURS`) and thinned, one long vector.

        Of surfaces at (T, V, 3) m.
        """
        parts = []
        for p in self.photographs:
            parts.append(thin(self.coverage(at, p) - p.mask, blur * reach(p.mask)).ravel())
        return np.concatenate(parts)


def reduced(photograph: MaskedPhotograph) -> MaskedPhotograph:
    """The photograph with fewer pixels, where the body is longer than `PIXELS`."""
    camera, factor = photograph.camera, max(1.0, reach(photograph.mask) / PIXELS)
    size = (round(camera.width / factor), round(camera.height / factor))
    scale = np.diag([size[0] / camera.width, size[1] / camera.height, 1.0])
    small = Camera(scale @ camera.intrinsics, camera.extrinsics, *size, camera.distortion)
    mask = cv2.resize(photograph.mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return replace(photograph, camera=small, mask=mask)


def reach(mask: np.ndarray) -> float:
    """Roughly the length of a body in pixels: three times the square root of its area."""
    return 3 * float(np.sqrt(mask.sum()))


def thin(picture: np.ndarray, sigma: float) -> np.ndarray:
    """A picture (H, W) blurred by `sigma` px and sampled about once a `sigma`, of the same sum of squares."""
    stride = max(1, int(sigma))
    return stride * cv2.GaussianBlur(picture, (0, 0), sigma)[stride // 2 :: stride, stride // 2 :: stride]


def coarse_fit(
    parameters: BodyParameters,
    pressures: np.ndarray,
    photographs: list[MaskedPhotograph],
    conditions: dict | None = None,
    device: str = "auto",
) -> Coarse:
    """Actuation parameters from silhouettes at pressures (T, chambers) kPa; the material stays.

    Raises InputError: a photograph shows no such body.
    """
    model = Skinned(parameters, pressures, photographs, conditions, device)
    tried = [np.clip(x, parameters.lower, parameters.upper) for x in _starts(parameters, pressures)]
    x = min(tried, key=lambda x: np.square(model.differences(model.positions(x), BLURS[0])).sum())
    for blur in BLURS:
        x = _fit_skinned(model, x, blur)
    _check(model, x, photographs)
    model.correct(x)
    return _refine(model, _fit_skinned(model, x, BLURS[-1]))


def _fit_skinned(model: Skinned, x: np.ndarray, blur: float) -> np.ndarray:
    """(P,) from `x` on, by bounded least squares at one blur; the material's coordinates stay."""
    parameters = model.parameters
    free = parameters.of_pose

    def misfit(y):
        return model.differences(model.positions(_whole(parameters, x, y)), blur)

    def jacobian(y):
        steps, here = _steps(parameters, y, SMALL), misfit(y)
        return np.stack([misfit(y + s) - here for s in steps], 1) / np.diag(steps)

    bounds, scale = (parameters.lower[free], parameters.upper[free]), parameters.step[free]
    how = {"x_scale": scale, "xtol": 1e-4, "ftol": 1e-4, "max_nfev": 25}
    found = least_squares(misfit, x[free], jacobian, bounds, **how)
    return _whole(parameters, x, found.x)


def _refine(model: Skinned, x: np.ndarray) -> Coarse:
    parameters = model.parameters
    free, lower, upper = parameters.of_pose, parameters.lower, parameters.upper
    scale = parameters.step[free]
    least, hessian = np.inf, np.zeros((len(x), len(x)))
    rest = model.correct(x)
    for _ in range(STEPS):
        steps = _steps(parameters, x[free], ROUGH_MOVE)
        candidates = np.stack([x, *(_whole(parameters, x, x[free] + s) for s in steps)])
        surfaces = model.surfaces(rest, rest.solve(candidates))
        pictures = np.stack([model.differences(at, BLURS[-1]) for at in surfaces])
        if np.square(pictures[0]).sum() > least:
            break
        best, least = x, np.square(pictures[0]).sum()
        # min |J dx + r|^2 between the bounds, H = J^T J
        J = (pictures[1:] - pictures[0]).T / np.diag(steps)
        hessian[np.ix_(free, free)] = J.T @ J
        bounds = ((lower - x)[free] / scale, (upper - x)[free] / scale)
        x = _whole(parameters, x, x[free] + scale * lsq_linear(J * scale, -pictures[0], bounds).x)
    return Coarse(best, hessian)


def _whole(parameters: BodyParameters, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`x` (P,) with the pose's coordinates (F,) in it, inside the bounds."""
    out = x.copy()
    out[parameters.of_pose] = y
    return np.clip(out, parameters.lower, parameters.upper)


def _steps(parameters: BodyParameters, y: np.ndarray, share: float) -> np.ndarray:
    """(F, F) a share of the first step along each of the pose's coordinates, to the inside of the bounds."""
    free = parameters.of_pose
    scale = parameters.step[free]
    return np.diag(share * np.where(y + share * scale < parameters.upper[free], scale, -scale))


def _check(model: Skinned, x: np.ndarray, photographs: list[MaskedPhotograph]) -> None:
    at = model.positions(x)
    for p, small in zip(photographs, model.photographs, strict=True):
        try:
            check_photograph(at[p.state], p.image, p.mask, p.camera)
        except InputError as e:
            raise InputError(f"{p.name}: {e}") from e
        drawn, mask = model.coverage(at, small) > 0.5, small.mask > 0.5
        iou = (drawn & mask).sum() / max((drawn | mask).sum(), 1)
        if iou < LEAST_IOU:
            raise InputError(
                f"{p.name}: the twin's silhouette overlaps the mask by {iou:.0%} at best; check the camera "
                "(extrinsics from base to camera, in metres), the twin's length and mesh, and the mask."
            )


def _starts(parameters: BodyParameters, pressures: np.ndarray) -> list[np.ndarray]:
    """The twin's own parameters, and a grid of bends (finger) or of gains and directions (arm)."""
    own = parameters.coordinates(parameters.twin)
    names = list(parameters.names)
    joints = len(parameters.twin.spine_joint_positions_mm)
    out = [own]
    if "rest_pressure_kpa" in names:
        low, high = pressures.min(), pressures.max()
        for first, last in product(BENDS_RAD, BENDS_RAD):
            if first == last:
                continue
            x = own.copy()
            gain = (last - first) / (joints * (high - low))
            x[names.index("gain_rad_per_kpa")] = gain
            x[names.index("rest_pressure_kpa")] = first / (joints * gain) - low
            out.append(x)
    else:
        for bend, angle in product((0.5, 1.2, 2.0), np.arange(6) * np.pi / 3):
            x = own.copy()
            x[names.index("gain_rad_per_kpa")] = bend / (joints * pressures.max())
            x[names.index("chamber_angle_rad")] = angle
            out.append(x)
    return out


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
