"""Frictionless contact of an elastic half-space with a rigid object, on a grid of equal rectangles.

Each rectangle carries an even pressure, whose displacements Love gave (Phil. Trans. R. Soc. A 228 (1929) 377;
Johnson, Contact Mechanics (1985) eq. 3.25); they superpose by FFT without wrapping round. Pressures that push
and touch, or neither, come by conjugate gradients (Polonsky and Keer, Wear 231 (1999) 206).
"""

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

TOLERANCE = 2e-3  # of the deepest point
STEPS = 60
LEAST_MM = 1e-9  # shallower is no contact: its squares would vanish in the arithmetic


class HalfSpace:
    """The surface of a half-space under rigid objects.

    Args:
        modulus_kpa: E / (1 - nu^2).
        cell_mm: size of a rectangle along columns and rows.
        shape: rows and columns.
    """

    def __init__(self, modulus_kpa: float, cell_mm: tuple[float, float], shape: tuple[int, int]):
        self._shape, self._area = shape, cell_mm[0] * cell_mm[1]
        self._padded = tuple(next_fast_len(2 * n - 1, real=True) for n in shape)
        y, x = (np.fft.fftfreq(n, 1 / n) * c for n, c in zip(self._padded, cell_mm[::-1], strict=True))
        given = love(x[None, :], y[:, None], cell_mm[0] / 2, cell_mm[1] / 2)
        self._spectrum = rfft2(given / (np.pi * modulus_kpa))
        self._last = np.zeros(shape)

    def displaced(self, pressure_kpa: np.ndarray) -> np.ndarray:
        """Displacement (rows, columns) into the body, mm, under pressures."""
        rows, columns = self._shape
        u = irfft2(rfft2(pressure_kpa, self._padded) * self._spectrum, self._padded)
        return u[:rows, :columns]

    def press(self, below_mm: np.ndarray) -> tuple[np.ndarray, float]:
        """What a rigid object does.

        Args:
            below_mm: (rows, columns) how far its surface lies below the resting one; negative above it.

        Returns:
            Displacement (rows, columns) in mm and the force in N.
        """
        inside = below_mm > LEAST_MM
        if not inside.any():
            self._last = np.zeros(self._shape)
            return np.zeros(self._shape), 0.0
        p = np.where(inside, np.maximum(self._last, 1e-3), 0.0)  # the last contact is near
        way, before, small = np.zeros(self._shape), 1.0, TOLERANCE * below_mm.max()
        u, carry = self.displaced(p), 0.0
        for _ in range(STEPS):
            miss, held = below_mm - u, p > 0
            size = float(np.square(miss[held]).sum())
            way = np.where(held, miss + carry * size / before * way, 0.0)
            answer = self.displaced(way)
            bears = float(answer[held] @ way[held])
            if not bears > 0:  # a step too far let go everywhere: start again, without the last contact
                p, carry = np.where(inside, 1e-3, 0.0), 0.0
                u = self.displaced(p)
                continue
            length = float(miss[held] @ way[held]) / bears
            p = np.maximum(p + length * way, 0.0)
            fresh = (p == 0) & (miss > small)
            p[fresh] = length * miss[fresh]
            carry, before = 0.0 if fresh.any() else 1.0, size
            u = self.displaced(p)
            if (below_mm - u).max() < small and np.abs((below_mm - u)[p > 0]).max() < small:
                break
        self._last = p
        return u, 1e-3 * self._area * float(p.sum())  # kPa mm^2 are mN


def love(x, y, a: float, b: float) -> np.ndarray:
    """Pi E* u / p at (x, y) under an even pressure p on a rectangle 2a by 2b, mm."""

    def corner(s, t):
        along, across = (np.maximum(np.abs(v), 1e-12) for v in (s, t))
        return s * np.arcsinh(t / along) + t * np.arcsinh(s / across)

    return corner(x + a, y + b) - corner(x - a, y + b) - corner(x + a, y - b) + corner(x - a, y - b)
