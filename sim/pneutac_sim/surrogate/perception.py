"""Perception network f_m: probe grid to the displacement that the gel's material points would show.

A three-level UNet (paper, Sec. "Action and Perception Networks") learns what the gel adds to the grid d,

    f_m(d) = d + g(d) - g(0),

so that where nothing touches within the network's sight the surface rests exactly. Biases and the zeros that
pad the window show g where the gel ends. The first level works on blocks of 2 x 2 cells, as four channels,
which costs a quarter and loses nothing.

Compiled, for one thread: a channel of a level is a plane of rows x columns cells, flattened with one column
of zeros between the rows, a row of zeros above and below it and `EDGE` cells before it. So the nine taps of a
convolution are nine shifts of one long line, along which the compiler makes vector instructions, and the
zeros are the padding. Planes of the coarser levels are short, so those of up to `BATCH` grids lie behind one
another in their lines.
"""

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import njit
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer, whole
from pneutac_sim.gel.probe import COLS, ROWS

BLOCK = 2
EDGE = 16
BATCH = 4  # grids at once; more of them leave the processor's cache
_FAST = {"contract", "nsz", "nnan"}  # products and sums in one instruction


def _half(n: int) -> int:
    return (n + 1) // 2


R1, C1 = _half(ROWS), _half(COLS)
R2, C2 = _half(R1), _half(C1)
R3, C3 = _half(R2), _half(C2)


def workspace(channels: tuple[int, int, int]) -> tuple[np.ndarray, ...]:
    """Zeroed planes for `added`, of the layers in the order in which it names them."""
    a, b, c = channels

    def planes(rows: int, cols: int, n: int, grids: int) -> tuple[int, int]:
        return n, 2 * EDGE + (grids * (rows + 1) + 1) * (cols + 1)

    shapes = [planes(R1, C1, n, 1) for n in (BLOCK**2, a)]
    shapes += [(BATCH, *planes(R1, C1, b + a, 1)), planes(R1, C1, a, 1)]
    shapes += [planes(R2, C2, n, BATCH) for n in (a, b, c + b, b)]
    shapes += [planes(R3, C3, n, BATCH) for n in (b, c, c)]
    return tuple(np.zeros(shape, np.float32) for shape in shapes)


def _level(rows: int, cols: int):
    """Compiles a convolution for lines of n grids; with a stride that is known only later it is slow."""
    stride = cols + 1
    first = EDGE + stride  # of the plane's own cells

    @njit(fastmath=_FAST)
    def taps(x, u, v, y, z, cells):
        """Adds to the lines y and z what the line x brings by the kernels u and v (9,)."""
        u0, u1, u2, u3, u4, u5, u6, u7, u8 = u[0], u[1], u[2], u[3], u[4], u[5], u[6], u[7], u[8]
        v0, v1, v2, v3, v4, v5, v6, v7, v8 = v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8]
        above, here, below = x[first - stride - 1 :], x[first - 1 :], x[first + stride - 1 :]
        y, z = y[first:], z[first:]
        for p in range(cells):
            a, b, c = above[p], above[p + 1], above[p + 2]
            d, e, f = here[p], here[p + 1], here[p + 2]
            g, h, i = below[p], below[p + 1], below[p + 2]
            y[p] += u0 * a + u1 * b + u2 * c + u3 * d + u4 * e + u5 * f + u6 * g + u7 * h + u8 * i
            z[p] += v0 * a + v1 * b + v2 * c + v3 * d + v4 * e + v5 * f + v6 * g + v7 * h + v8 * i

    @njit
    def convolve(x, w, bias, y, n):
        """Fills planes y (outputs, ...), of even number, with max(0, w * x + bias) of x (inputs, ...)."""
        lines = n * (rows + 1) - 1
        last = first + lines * stride
        for o in range(0, len(y), 2):
            upper, lower = y[o], y[o + 1]
            for p in range(first, last):
                upper[p], lower[p] = bias[o], bias[o + 1]
            for k in range(len(x)):
                taps(x[k], w[o, k], w[o + 1, k], upper, lower, last - first)
        for o in range(len(y)):
            line = y[o]
            for p in range(first, last):
                line[p] = max(line[p], np.float32(0.0))
            for i in range(lines):
                line[first + i * stride + cols] = 0.0
            for g in range(1, n):  # the row between two grids
                at = first + (g * (rows + 1) - 1) * stride
                for p in range(at, at + cols):
                    line[p] = 0.0

    return convolve


_convolve1, _convolve2, _convolve3 = _level(R1, C1), _level(R2, C2), _level(R3, C3)


@njit(cache=True)
def _pool(fine, grid, rows, cols, coarse, coarse_grid, coarse_cols):
    """Largest of each 2 x 2 cells; what is missing at the rim is zero, as no cell is below."""
    half = (rows + 1) // 2
    for k in range(len(fine)):
        for i in range(half):
            source = EDGE + (grid * (rows + 1) + 2 * i + 1) * (cols + 1)
            to = EDGE + (coarse_grid * (half + 1) + i + 1) * (coarse_cols + 1)
            for j in range(coarse_cols):
                at = source + 2 * j
                below = at + cols + 1
                upper, lower = max(fine[k, at], fine[k, at + 1]), max(fine[k, below], fine[k, below + 1])
                coarse[k, to + j] = max(upper, lower)


@njit(cache=True)
def _enlarge(coarse, coarse_grid, coarse_cols, fine, grid, rows, cols):
    half = (rows + 1) // 2
    for k in range(len(coarse)):
        for i in range(rows):
            at = EDGE + (grid * (rows + 1) + i + 1) * (cols + 1)
            source = EDGE + (coarse_grid * (half + 1) + i // 2 + 1) * (coarse_cols + 1)
            for j in range(cols):
                fine[k, at + j] = coarse[k, source + j // 2]


@njit(inline="always")  # into its one caller: else it would be compiled twice
def added(kernels, biases, work, depth):
    """g(d) of `perception.UNet` in mm, in place of some grids d (n, ROWS, COLS), n up to `BATCH`.

    Kernels are (outputs, inputs, 9) each, of the convolutions in the order down1, down2, down3, up2, up1, two
    of each, and (4, inputs, 1) of the last one; biases (outputs,) each.
    """
    blocks, h1, skip1, y1, p2, h2, skip2, y2, p3, h3, y3 = work
    w, b, n = kernels, biases, len(depth)
    # The skipped level is laid behind the enlarged coarser one.
    own2 = skip2[len(skip2) - len(p3) :]
    for g in range(n):
        for i in range(ROWS):
            for j in range(COLS):
                at = EDGE + (i // BLOCK + 1) * (C1 + 1) + j // BLOCK
                blocks[(i % BLOCK) * BLOCK + j % BLOCK, at] = depth[g, i, j]
        own1 = skip1[g, skip1.shape[1] - len(p2) :]
        _convolve1(blocks, w[0], b[0], h1, 1)
        _convolve1(h1, w[1], b[1], own1, 1)
        _pool(own1, 0, R1, C1, p2, g, C2)
    _convolve2(p2, w[2], b[2], h2, n)
    _convolve2(h2, w[3], b[3], own2, n)
    for g in range(n):
        _pool(own2, g, R2, C2, p3, g, C3)
    _convolve3(p3, w[4], b[4], h3, n)
    _convolve3(h3, w[5], b[5], y3, n)
    for g in range(n):
        _enlarge(y3, g, C3, skip2, g, R2, C2)
    _convolve2(skip2, w[6], b[6], h2, n)
    _convolve2(h2, w[7], b[7], y2, n)
    for g in range(n):
        _enlarge(y2, g, C2, skip1[g], 0, R1, C1)
        _convolve1(skip1[g], w[8], b[8], h1, 1)
        _convolve1(h1, w[9], b[9], y1, 1)
        _last(y1, w[10], b[10], depth[g])


@njit(inline="always")
def _last(y, w, bias, out):
    """The convolution (4, inputs, 1) of planes y, as a grid."""
    for i in range(ROWS):
        for j in range(COLS):
            k, at = (i % BLOCK) * BLOCK + j % BLOCK, EDGE + (i // BLOCK + 1) * (C1 + 1) + j // BLOCK
            total = bias[k]
            for c in range(len(y)):
                total += w[k, c, 0] * y[c, at]
            out[i, j] = total


@njit(cache=True)
def displacements(kernels, biases, work, grids, rest, least_mm, deepest_mm, out):
    """Fills `out` with d + g(min(d, deepest)) - rest of grids d (B, ROWS, COLS).

    Grids whose largest depth is `least_mm` or less stay as they are. Returns whether all depths are finite.
    """
    known, which, n = np.empty((BATCH, ROWS, COLS), np.float32), np.empty(BATCH, np.int64), 0
    for m in range(len(grids)):
        peak = np.float32(0.0)
        for i in range(ROWS):
            for j in range(COLS):
                d = grids[m, i, j]
                if not np.isfinite(d):
                    return False
                peak = max(peak, d)
                known[n, i, j] = min(d, deepest_mm)
                out[m, i, j] = d
        if peak > least_mm:
            which[n] = m
            n += 1
        if n == BATCH or (n and m == len(grids) - 1):
            added(kernels, biases, work, known[:n])
            for k in range(n):
                for i in range(ROWS):
                    for j in range(COLS):
                        out[which[k], i, j] += known[k, i, j] - rest[i, j]
            n = 0
    return True


FORMAT = "pneutac-gel-surrogate/1"
LAYERS = (*(f"{level}.{i}" for level in ("down1", "down2", "down3", "up2", "up1") for i in (0, 2)), "out")


class GelSurrogate:
    """A trained perception network, evaluated on one thread.

    The weights are float32, those of `gel_train.UNet.weights`, for the gel with this fingerprint.
    `deepest_mm` is the largest value of a probe grid and `largest_share` the largest share of the window in
    contact that it was trained with, `heldout` the indenters that it was not; `errors` are what
    `evaluate_gel` found.

    Raises ValueError: the weights are not those of such a network, or not finite.
    """

    def __init__(
        self,
        weights: Mapping[str, np.ndarray],
        fingerprint: str,
        deepest_mm: float,
        largest_share: float,
        heldout: Sequence[str] = (),
        errors: dict | None = None,
    ):
        self.weights = {k: np.ascontiguousarray(v, np.float32) for k, v in weights.items()}
        _check(self.weights)
        self.fingerprint, self.heldout, self.errors = fingerprint, tuple(heldout), errors or {}
        self.deepest_mm, self.largest_share = deepest_mm, largest_share

    def displacement(self, depth_mm: np.ndarray) -> np.ndarray:
        """Displacement of the gel's face in mm under probe grids, ([B,] 80, 59), float32.

        It is zero where a grid is. Beyond `deepest_mm` the gel adds what it adds there. A grid among others
        is rounded otherwise than alone (1e-6 mm). Raises ValueError where the shape is another or a depth not
        finite.
        """
        depth = np.asarray(depth_mm, np.float32)
        if depth.ndim not in (2, 3) or depth.shape[-2:] != (ROWS, COLS):
            raise ValueError(f"probe grids have shape ([B,] {ROWS}, {COLS}); got {depth.shape}")
        grids = depth.reshape(-1, ROWS, COLS)
        out = np.empty_like(grids)
        deepest = np.float32(self.deepest_mm)
        if not displacements(*self._network, grids, self._rest, np.float32(0), deepest, out):
            raise ValueError("a probe grid holds a depth that is no finite number")
        return out.reshape(depth.shape)

    @cached_property
    def _network(self) -> tuple:
        """Kernels, biases and work space, as the compiled code takes them."""
        kernels = [self.weights[f"{layer}.weight"] for layer in LAYERS]
        biases = tuple(self.weights[f"{layer}.bias"] for layer in LAYERS)
        flat = tuple(np.ascontiguousarray(k.reshape(*k.shape[:2], -1)) for k in kernels)
        return flat, biases, workspace(_channels(self.weights))

    @cached_property
    def _rest(self) -> np.ndarray:
        zero, out = np.zeros((1, ROWS, COLS), np.float32), np.empty((1, ROWS, COLS), np.float32)
        displacements(*self._network, zero, zero[0], np.float32(-1), np.float32(self.deepest_mm), out)
        return out[0]

    def out_of_range(self, depth_mm: np.ndarray) -> np.ndarray:
        """Whether probe grids (..., 80, 59) lie deeper, or cover more of the window, than in training."""
        depth = np.asarray(depth_mm)
        share = np.count_nonzero(depth, (-2, -1)) / (ROWS * COLS)
        return (depth.max((-2, -1)) > self.deepest_mm) | (share > self.largest_share)

    def save(self, path: str | Path) -> None:
        """Writes weights and what is known about them as safetensors."""
        metadata = {
            "format": FORMAT,
            "fingerprint": self.fingerprint,
            "deepest_mm": repr(float(self.deepest_mm)),
            "largest_share": repr(float(self.largest_share)),
            "heldout": json.dumps(self.heldout),
            "errors": json.dumps(self.errors),
        }
        with whole(Path(path)) as part:
            part.write_bytes(save(self.weights, metadata))

    @classmethod
    def load(cls, path: str | Path) -> "GelSurrogate":
        """Reads what `save` wrote.

        Raises InputError where there is no such file, or it is damaged or of another kind.
        """
        if not Path(path).is_file():
            raise InputError(f"There is no perception network '{path}'; train one with `pneutac surrogate`.")
        refuse_pointer(Path(path))
        try:
            with safe_open(path, "np") as f:
                about, weights = f.metadata() or {}, {k: f.get_tensor(k) for k in f.keys()}  # noqa: SIM118
            limits = (float(about["deepest_mm"]), float(about["largest_share"]))
            if about["format"] != FORMAT or not all(0 < v < np.inf for v in limits):
                raise ValueError
            more = (json.loads(about[k]) for k in ("heldout", "errors"))
            return cls(weights, about["fingerprint"], *limits, *more)
        except (SafetensorError, OSError, KeyError, ValueError) as e:
            raise InputError(
                f"'{path}' is no perception network, or is damaged; train one with `pneutac surrogate`."
            ) from e


def _channels(weights: Mapping[str, np.ndarray]) -> tuple[int, int, int]:
    return tuple(len(weights[f"down{level}.0.bias"]) for level in (1, 2, 3))


def _check(weights: Mapping[str, np.ndarray]) -> None:
    a, b, c = _channels(weights)
    block = BLOCK**2
    outputs = (a, a, b, b, c, c, b, b, a, a, block)
    inputs = (block, a, a, b, b, c, c + b, b, b + a, a, a)
    wanted = {f"{layer}.bias": (o,) for layer, o in zip(LAYERS, outputs, strict=True)}
    for layer, o, i in zip(LAYERS, outputs, inputs, strict=True):
        wanted[f"{layer}.weight"] = (o, i, 1, 1) if layer == "out" else (o, i, 3, 3)
    if {k: w.shape for k, w in weights.items()} != wanted or any(n % 2 for n in (a, b, c)):
        raise ValueError("these are not the weights of the perception network")
    if not all(np.isfinite(w).all() for w in weights.values()):
        raise ValueError("the perception network has weights that are no finite numbers")
