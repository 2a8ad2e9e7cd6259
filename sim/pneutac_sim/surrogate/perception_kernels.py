"""Compiled evaluation of the perception network's UNet, on one thread.

A channel of a level is a plane of rows x columns cells, flattened with one column of zeros between the rows,
a row of zeros above and below it and `EDGE` cells before it. So the nine taps of a convolution are nine
shifts of one long line, along which the compiler makes vector instructions, and the zeros are the padding.
Planes of the coarser levels are short, so those of up to `BATCH` grids lie behind one another in their lines.
"""

import numpy as np
from numba import njit

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


def _level(rows: int, cols: int, grids: int = 1):
    """Compiles a convolution for lines of one length; with a length that is known only later it is slow."""
    stride, lines = cols + 1, grids * (rows + 1) - 1
    cells = lines * stride
    first = EDGE + stride  # of the plane's own cells

    @njit(fastmath=_FAST)
    def taps(x, w, v, y, z):
        """Adds to the lines y and z what the line x brings by the kernels w and v (9,)."""
        w0, w1, w2, w3, w4, w5, w6, w7, w8 = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8]
        v0, v1, v2, v3, v4, v5, v6, v7, v8 = v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8]
        for p in range(first, first + cells):
            a, b, c = x[p - stride - 1], x[p - stride], x[p - stride + 1]
            d, e, f = x[p - 1], x[p], x[p + 1]
            g, h, i = x[p + stride - 1], x[p + stride], x[p + stride + 1]
            y[p] += w0 * a + w1 * b + w2 * c + w3 * d + w4 * e + w5 * f + w6 * g + w7 * h + w8 * i
            z[p] += v0 * a + v1 * b + v2 * c + v3 * d + v4 * e + v5 * f + v6 * g + v7 * h + v8 * i

    @njit
    def convolve(x, w, bias, y):
        """Fills planes y (outputs, ...), of even number, with max(0, w * x + bias) of x (inputs, ...)."""
        for o in range(0, len(y), 2):
            y[o, first : first + cells] = bias[o]
            y[o + 1, first : first + cells] = bias[o + 1]
            for k in range(len(x)):
                taps(x[k], w[o, k], w[o + 1, k], y[o], y[o + 1])
        for o in range(len(y)):
            line = y[o]
            for p in range(first, first + cells):
                line[p] = max(line[p], np.float32(0.0))
            for i in range(lines):
                line[first + i * stride + cols] = 0.0
            for g in range(1, grids):  # the row between two grids
                at = first + (g * (rows + 1) - 1) * stride
                line[at : at + cols] = 0.0

    return convolve


_convolve1, _convolve2, _convolve3 = _level(R1, C1), _level(R2, C2), _level(R3, C3)
_convolve2_all, _convolve3_all = _level(R2, C2, BATCH), _level(R3, C3, BATCH)


@njit
def _coarse2(x, w, bias, y, n):
    """Convolves the planes of n grids; where they are more than one, of all that there is room for."""
    if n == 1:
        _convolve2(x, w, bias, y)
    else:
        _convolve2_all(x, w, bias, y)


@njit
def _coarse3(x, w, bias, y, n):
    if n == 1:
        _convolve3(x, w, bias, y)
    else:
        _convolve3_all(x, w, bias, y)


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


@njit(cache=True)
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
        _convolve1(blocks, w[0], b[0], h1)
        _convolve1(h1, w[1], b[1], own1)
        _pool(own1, 0, R1, C1, p2, g, C2)
    _coarse2(p2, w[2], b[2], h2, n)
    _coarse2(h2, w[3], b[3], own2, n)
    for g in range(n):
        _pool(own2, g, R2, C2, p3, g, C3)
    _coarse3(p3, w[4], b[4], h3, n)
    _coarse3(h3, w[5], b[5], y3, n)
    for g in range(n):
        _enlarge(y3, g, C3, skip2, g, R2, C2)
    _coarse2(skip2, w[6], b[6], h2, n)
    _coarse2(h2, w[7], b[7], y2, n)
    for g in range(n):
        _enlarge(y2, g, C2, skip1[g], 0, R1, C1)
        _convolve1(skip1[g], w[8], b[8], h1)
        _convolve1(h1, w[9], b[9], y1)
        _last(y1, w[10], b[10], depth[g])


@njit(cache=True)
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
def displacements(kernels, biases, work, grids, rest, deepest_mm, out):
    """Fills `out` with d + g(min(d, deepest)) - g(0) of grids d (B, ROWS, COLS); what rests stays at d.

    Returns whether all depths are finite.
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
        out[m] = grids[m]
        if peak > 0.0:
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
