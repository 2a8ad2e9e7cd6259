"""The residual field: what a gel's model leaves over, learnt from several presses.

It adds to a channel of the image

    a(u) b(x, y) sum_j c_j k(z, z_j),   a = min(1, u / A),   k = exp(-|z - z_j|^2 / 2),

with z the slopes, the displacement u, u blurred, the height of the shadow over it and the place, each over
a length of its own. The c_j make least the squared error over the presses, each of which counts as so many
independent pixels, plus c^T K c / B^2, B the field's standard deviation: far from all that was seen nothing
is added. b = exp(-d^2 / 2 R^2), d the distance to the nearest place of a z_j: what presses at one side of a
gel have in common need not hold at the other. The weight w, which rises steeply where a rest image is bright,
does not act on the field: it would carry what was learnt at a dark place many times larger to a bright one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numba import njit

from pneutac_sim.effects.shadow import cast
from pneutac_sim.errors import InputError

SLOPE, DEPTH_MM, SHADOW_MM, PLACE_MM = 0.35, 0.45, 0.3, 8.0  # over which the field changes
BLUR_MM = 1.0
# What a model leaves over is smooth over a contact, so that a photograph counts as so many independent pixels
# of this error.
INDEPENDENT, ERROR_LEVELS = 100, 5.0
REACH_MM = 1.5  # R
MOVED_MM = 0.05  # A: a surface that moves less has less of the field
CENTRES, STRENGTH_LEVELS = 128, 16.0  # of a sensor's own field; its weight comes from its presses
LEAST_WEIGHT = 0.1  # where w is less, the field fades with it, since a pixel's w may be far from its cell's
FEATURES, SHADOW, PLACE = 7, 4, slice(5, 7)  # of z; the shadow's height, x and y among them
LEAST_MM = 3e-3  # a surface that moves less has nothing of the field
BLOCK = 256  # cells
E = tuple(np.float32([0.99999933, 0.99995751, 0.49954305, 0.16480388, 0.03810768, 0.00500946]))
ROUNDING_LEVELS = 12**-0.5  # of an 8-bit image: a field far below it is none


@dataclass(frozen=True, eq=False)
class ResidualField:
    """Levels to add to each channel of the image.

    Raises InputError: they are no such numbers.
    """

    centres: np.ndarray  # z_j of red, green and blue, (3, n, 7) float32
    weights: np.ndarray  # c_j, (3, n) levels, float32
    _reaches: dict = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self):
        shapes = np.shape(self.centres), np.shape(self.weights)
        n = shapes[1][-1] if shapes[1] else 0
        finite = n and np.isfinite(self.centres).all() and np.isfinite(self.weights).all()
        if shapes != ((3, n, FEATURES), (3, n)) or not finite:
            raise InputError(
                f"The gel's residual field must be finite numbers of shapes (3, n, {FEATURES}) and (3, n); "
                f"got {shapes[0]} and {shapes[1]}; calibrate the gel again."
            )

    def at(self, k: int, z: np.ndarray) -> np.ndarray:
        """Levels (n,) of channel k at z (n, 7), where the surface moves enough."""
        return _reach(self.centres[k], z[:, PLACE]) * (_kernel(z, self.centres[k]) @ self.weights[k])

    def reach(self, shape: tuple[int, ...], cell_mm: tuple[float, float]) -> np.ndarray:
        """B of each channel on a grid, (3, rows, columns)."""
        key = *shape, *cell_mm
        if key not in self._reaches:
            where = places(shape, cell_mm).reshape(-1, 2)
            self._reaches[key] = np.stack([_reach(c, where) for c in self.centres]).reshape(3, *shape)
        return self._reaches[key]

    def times(self, share: float) -> "ResidualField":
        return ResidualField(self.centres, np.float32(share) * self.weights)

    def shown(self, channels: tuple[int, int, int], mirror_x: bool, mirror_y: bool) -> "ResidualField":
        """The same as images with other channels, or mirrored, show it; see `gel.layout.Orientation`."""
        turn = np.ones(FEATURES, np.float32)
        turn[[0, 5]], turn[[1, 6]] = -1 if mirror_x else 1, -1 if mirror_y else 1
        return ResidualField(turn * self.centres[list(channels)], self.weights[list(channels)])


def mean(fields: Sequence[ResidualField]) -> ResidualField:
    """The mean of some fields."""
    weights = np.concatenate([f.weights for f in fields], 1) / np.float32(len(fields))
    return ResidualField(np.concatenate([f.centres for f in fields], 1), weights)


def levels(
    fields: Sequence[ResidualField], displacement_mm: np.ndarray, cell_mm, shadows: Sequence[np.ndarray]
) -> np.ndarray:
    """What fields of one sensor add together where w is not small, levels, float32 (3, rows, columns).

    Of a displacement (rows, columns) float32 mm, and of the height in mm of each channel's shadow over it.
    """
    u, shadows = displacement_mm, np.asarray(shadows, np.float32)
    out = np.zeros((3, *u.shape), np.float32)
    z, cells = _features(u, _blurred(u, cell_mm), *cell_mm, LEAST_MM)
    for f in fields if len(cells) else ():
        _add(z, cells, u, shadows, f.reach(u.shape, cell_mm), f.centres, f.weights, out)
    return out


def faded(weight: np.ndarray) -> np.ndarray:
    """What a field is multiplied by where the light's weight is w: less where w is small."""
    return np.minimum(1, weight / LEAST_WEIGHT)


@dataclass
class Leftover:
    """What a model leaves over of one photograph."""

    features: np.ndarray  # z of each channel, (3, n, 7), of n cells near the contact
    factor: np.ndarray  # what the field is multiplied by in each channel, (3, n): a, less where w is small
    levels: np.ndarray  # (3, n)
    in_contact: np.ndarray  # which cells lie in the contact, (n,) bool

    @classmethod
    def of(cls, u, cell_mm, coefficients, weight, levels, near, in_contact) -> "Leftover":
        """From grids: u (rows, columns) mm, weight and levels (rows, columns, 3), two bool."""
        z = np.stack([features(u, cell_mm, row)[near] for row in coefficients])
        factor = _share(u)[..., None] * faded(weight)
        return cls(z, factor[near].T, levels[near].T, in_contact[near])

    def added(self, residual: ResidualField) -> np.ndarray:
        """What a field adds there, (3, n) levels."""
        return np.stack([self.factor[k] * residual.at(k, z) for k, z in enumerate(self.features)])


def trusted_share(tried: Sequence[tuple[ResidualField, Leftover]]) -> float:
    """How much of a field to take, 0 to 1, from fields and the press that each was not learnt from.

    That is the factor sum f r / sum (f^2 + rounding^2) by which the fields f come nearest to what is left,
    r, in those presses' contacts, less its standard deviation by the jackknife over presses.
    """
    sums = []
    for residual, one in tried:
        f, r = one.added(residual)[:, one.in_contact], one.levels[:, one.in_contact]
        sums.append([(f * r).mean(), (f * f).mean() + ROUNDING_LEVELS**2])
    whole, n = np.sum(sums, 0), len(sums)
    share, (top, bottom) = whole[0] / whole[1], (whole - sums).T
    sd = np.sqrt((n - 1) * np.var(top / bottom))
    return float(np.clip(share - sd, 0, 1))


def learn(
    seen: Sequence[Leftover], cells: int = CENTRES, strength_levels: float = STRENGTH_LEVELS
) -> ResidualField:
    """The field of some photographs, round so many of their cells, of this standard deviation."""
    worth = np.concatenate([np.full(s.levels.shape[1], 1 / s.levels.shape[1]) for s in seen])
    worth *= INDEPENDENT / ERROR_LEVELS**2
    centres, weights = [], []
    for k in range(3):
        z, factor, left = (
            np.concatenate([a[k] for a in each])
            for each in ([s.features for s in seen], [s.factor for s in seen], [s.levels for s in seen])
        )
        chosen = np.random.default_rng(0).choice(
            len(z), min(cells, len(z)), p=factor**2 / np.square(factor).sum(), replace=False
        )
        A, K = factor[:, None] * _kernel(z, z[chosen]), _kernel(z[chosen], z[chosen])
        damping = (K + 1e-4 * np.eye(len(K))) / strength_levels**2
        centres.append(z[chosen])
        weights.append(np.linalg.solve(A.T @ (worth[:, None] * A) + damping, A.T @ (worth * left)))
    return ResidualField(np.array(centres, np.float32), np.array(weights, np.float32))


def features(displacement_mm: np.ndarray, cell_mm, row: np.ndarray) -> np.ndarray:
    """What z is in each cell, float32 (rows, columns, 7), of a surface in mm and a channel's coefficients."""
    u = np.ascontiguousarray(displacement_mm, np.float32)
    z, _ = _features(u, _blurred(u, cell_mm), *cell_mm, -np.inf)
    z[SHADOW] = cast(u, *cell_mm, row).ravel() / SHADOW_MM
    return z.T.reshape(*u.shape, FEATURES)


def _blurred(u: np.ndarray, cell_mm) -> np.ndarray:
    sigma_x, sigma_y = BLUR_MM / cell_mm[0], BLUR_MM / cell_mm[1]
    return cv2.GaussianBlur(u, (0, 0), sigma_x, sigmaY=sigma_y, borderType=cv2.BORDER_REFLECT)


@njit(cache=True, error_model="numpy")
def _features(u, blurred, hx, hy, least):
    """Of the cells in which u is more than `least`: z without shadows (7, n), and their flat indices (n,)."""
    rows, cols = u.shape
    z, cells = np.zeros((FEATURES, rows * cols), np.float32), np.empty(rows * cols, np.int64)
    n = 0
    for i in range(rows):
        up, down = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(cols):
            if u[i, j] <= least:
                continue
            left, right = max(j - 1, 0), min(j + 1, cols - 1)
            z[0, n] = (u[i, right] - u[i, left]) / (hx * (right - left) * SLOPE)
            z[1, n] = (u[down, j] - u[up, j]) / (hy * (down - up) * SLOPE)
            z[2, n], z[3, n] = u[i, j] / DEPTH_MM, blurred[i, j] / DEPTH_MM
            z[5, n], z[6, n] = (j + 0.5 - cols / 2) * hx / PLACE_MM, (i + 0.5 - rows / 2) * hy / PLACE_MM
            cells[n] = i * cols + j
            n += 1
    return np.ascontiguousarray(z[:, :n]), cells[:n]


@njit(cache=True, fastmath=True)
def _add(z, cells, u, shadows, reach, centres, weights, out):
    """Adds a field to `out` in some cells. Blocks stay in the cache; loops over cells vectorise.

    e^x is the 16th power of a polynomial of x / 16, off by a part in 100,000.
    """
    n, flat = len(cells), u.ravel()
    half, total = np.empty(n, np.float32), np.empty(n, np.float32)
    for k in range(3):
        shadow, near, added = shadows[k].ravel(), reach[k].ravel(), out[k].ravel()
        for i in range(n):
            z[SHADOW, i] = shadow[cells[i]] / np.float32(SHADOW_MM)
            half[i] = total[i] = 0
            for f in range(FEATURES):
                half[i] += np.float32(1 / 32) * z[f, i] * z[f, i]
        for j in range(len(weights[k])):
            c = centres[k, j] / np.float32(16)
            own = np.float32(-8) * np.float32(np.square(c).sum())
            c0, c1, c2, c3, c4, c5, c6 = c[0], c[1], c[2], c[3], c[4], c[5], c[6]
            w = weights[k, j]
            for i in range(n):
                x = own - half[i] + c0 * z[0, i] + c1 * z[1, i] + c2 * z[2, i] + c3 * z[3, i]
                x = max(x + c4 * z[4, i] + c5 * z[5, i] + c6 * z[6, i], np.float32(-1))
                e = E[0] + x * (E[1] + x * (E[2] + x * (E[3] + x * (E[4] + x * E[5]))))
                e *= e
                e *= e
                e *= e
                e *= e
                total[i] += w * e
        for i in range(n):
            a = min(flat[cells[i]] / np.float32(MOVED_MM), np.float32(1))
            added[cells[i]] += a * near[cells[i]] * total[i]


def places(shape: tuple[int, ...], cell_mm) -> np.ndarray:
    """X and y of z in each cell, (rows, columns, 2)."""
    y, x = (
        (np.arange(n) + 0.5 - n / 2) * size / PLACE_MM for n, size in zip(shape, cell_mm[::-1], strict=True)
    )
    return np.stack(np.meshgrid(x, y), -1)


def _reach(centres: np.ndarray, places: np.ndarray) -> np.ndarray:
    """B (n,) at places (n, 2), of centres (m, 7)."""
    squared = np.square(places[:, None] - centres[None, :, PLACE]).sum(-1).min(1)
    return np.exp(-squared * (PLACE_MM / REACH_MM) ** 2 / 2).astype(np.float32)


def _share(u: np.ndarray) -> np.ndarray:
    return np.minimum(u / np.float32(MOVED_MM), 1)


def _kernel(z: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(n, m) k of z (n, 7) and centres (m, 7)."""
    out = z @ centres.T
    out -= np.square(z).sum(1)[:, None] / 2
    out -= np.square(centres).sum(1) / 2
    return np.exp(np.minimum(out, 0, out=out), out=out)
