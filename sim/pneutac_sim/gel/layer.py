"""Contact of a rigid object with an elastic layer on a rigid backing, solved in full.

The gel is an isotropic layer of thickness t, shear modulus G and Poisson's ratio nu, bonded to its window and
pressed without friction. A pressure wave p e^{ikx} on its face moves the face by C(k) p e^{ikx} into the gel,

    C(k) = (1 - nu) / (G k) * (2 K sinh 2z - 4 z) / (2 K cosh 2z + 1 + K^2 + 4 z^2),  z = k t,  K = 3 - 4 nu,

which follows from stress functions that are harmonic along the face, with no shear on it and no
displacement at the backing (Johnson, Contact Mechanics, Sec. 5.8; Barber, Contact Mechanics). Short waves see
a half-space, (1 - nu) / (G k); a uniform pressure sees a column that cannot widen,
t (1 - 2 nu) / (2 G (1 - nu)).

With d the imprint, displacement u = C * p and gap g = u - d the contact is

    p >= 0,  g >= 0,  p g = 0,

solved by conjugate gradients on the points that carry pressure (Polonsky & Keer, Wear 231, 1999).
"""

import numpy as np
from scipy import fft

from pneutac_sim.errors import InputError
from pneutac_sim.gel.probe import COLS, ROWS, THICKNESS_MM, WINDOW_MM

TOLERANCE = 1e-3  # of the depth: largest gap or overlap, relative, at which the search ends
FINEST_MM = 1e-5  # single precision resolves no finer gap
MAX_ITERATIONS = 200


class LayerGel:
    """An elastic layer under the probe grid; its `displacement` fits `TactileSensor.surface`.

    What an object does where it stands above the resting surface is not in the imprint, so nothing is pressed
    there, and the face bulges freely.
    """

    def __init__(
        self,
        window_mm: tuple[float, float] = WINDOW_MM,
        thickness_mm: float = THICKNESS_MM,
        poissons_ratio: float = 0.49,
        shear_modulus_mpa: float = 0.02,
        stiffening_mm: float = np.inf,
        shape: tuple[int, int] = (ROWS, COLS),
    ):
        """A gel at rest.

        Args:
            window_mm: width (columns) and height (rows) of the gel's window.
            thickness_mm: t.
            poissons_ratio: nu, from 0 to below 0.5.
            shear_modulus_mpa: G; it scales the pressure alone.
            stiffening_mm: d0 of a gel that stiffens as it is pressed: a depth d goes in by d / (1 + d / d0).
            shape: rows and columns.

        Raises:
            InputError: a number is out of its range.
        """
        for name, value in (
            ("thickness_mm", thickness_mm),
            ("shear_modulus_mpa", shear_modulus_mpa),
            ("stiffening_mm", stiffening_mm),
        ):
            if not value > 0:
                raise InputError(f"The layer's {name} is {value}; it must be above zero.")
        if not 0 <= poissons_ratio < 0.5:
            raise InputError(
                f"The layer's poissons_ratio is {poissons_ratio}; it must be from 0 to below 0.5."
            )
        self._shape, self._stiffening = shape, stiffening_mm
        cell = (window_mm[1] / shape[0], window_mm[0] / shape[1])
        # The layer forgets within about three thicknesses, so that padding keeps its periodic images apart.
        self._padded = tuple(
            fft.next_fast_len(n + int(np.ceil(3 * thickness_mm / h)), real=True)
            for n, h in zip(shape, cell, strict=True)
        )
        ky = 2 * np.pi * fft.fftfreq(self._padded[0], cell[0])
        kx = 2 * np.pi * fft.rfftfreq(self._padded[1], cell[1])
        k = np.hypot(ky[:, None], kx[None, :])
        self._compliance = compliance(k, thickness_mm, poissons_ratio, shear_modulus_mpa).astype(np.float32)

    def displacement(self, depth_mm: np.ndarray) -> np.ndarray:
        """Displacement of the gel's face under an imprint.

        Args:
            depth_mm: (rows, columns) of the pressing objects below the resting face, zero off them.

        Returns:
            Into the gel, mm, float32, same shape; negative where the face bulges.

        Raises:
            InputError: the imprint has another shape.
        """
        return self._move(self.pressure(depth_mm))

    def pressure(self, depth_mm: np.ndarray) -> np.ndarray:
        """Pressure under an imprint, MPa, float32 (rows, columns); arguments as of `displacement`."""
        if depth_mm.shape != self._shape:
            raise InputError(f"The imprint has shape {depth_mm.shape}; the layer's is {self._shape}.")
        d = np.asarray(depth_mm, np.float32)
        d = d / (1 + d / np.float32(self._stiffening))
        p = d.copy()
        if not p.any():
            return p
        p *= np.vdot(p, d) / np.vdot(p, self._move(p))  # the best multiple of the imprint
        return self._solve(p, d, max(TOLERANCE * float(d.max()), FINEST_MM))

    def _solve(self, p: np.ndarray, d: np.ndarray, tolerance: float) -> np.ndarray:
        """Pressure (rows, columns) under an imprint from the guess `p`, by Polonsky & Keer's steps."""
        touchable = d > 0
        t = np.zeros_like(p)
        norm, restart = 1.0, True
        for _ in range(MAX_ITERATIONS):
            g = self._move(p) - d
            carries = p > 0
            open_ = np.abs(g[carries]).max(initial=0.0)
            overlap = -g[touchable & ~carries].min(initial=0.0)
            if max(open_, overlap) < tolerance:
                break
            g_in = np.where(carries, g, 0)
            before, norm = norm, float(np.vdot(g_in, g_in))
            t = g_in + (0.0 if restart else norm / before) * np.where(carries, t, 0)
            length = np.float32(np.vdot(g_in, t) / max(np.vdot(t, self._move(t)), 1e-30))
            p = np.maximum(p - length * t, 0)
            # What overlaps without carrying pressure joins, and the directions of search start afresh.
            joins = touchable & (p == 0) & (g < 0)
            restart = bool(joins.any())
            if restart:
                p = np.where(joins, -length * g, p)
        return p

    def _move(self, p: np.ndarray) -> np.ndarray:
        """C * p: displacement (rows, columns) of a pressure, mm."""
        wave = fft.rfft2(p, self._padded)
        wave *= self._compliance
        return fft.irfft2(wave, self._padded, overwrite_x=True)[: self._shape[0], : self._shape[1]]


def compliance(
    k_per_mm: np.ndarray, thickness_mm: float, poissons_ratio: float, shear_modulus_mpa: float
) -> np.ndarray:
    """C(k): displacement of the face over a pressure wave of this wave number.

    Args:
        k_per_mm: wave number, rad/mm, from 0.
        thickness_mm: t.
        poissons_ratio: nu.
        shear_modulus_mpa: G.

    Returns:
        mm/MPa, the shape of `k_per_mm`.
    """
    nu, G, K = poissons_ratio, shear_modulus_mpa, 3 - 4 * poissons_ratio
    z = np.maximum(k_per_mm, 1e-9) * thickness_mm
    short = np.exp(-2 * z)  # both sides of the fraction times e^{-2z}: nothing overflows
    over = K * (1 - short**2) - 4 * z * short
    under = K * (1 + short**2) + (1 + K**2 + 4 * z**2) * short
    wave = (1 - nu) * thickness_mm / (G * z) * over / under
    column = thickness_mm * (1 - 2 * nu) / (2 * G * (1 - nu))
    return np.where(z < 1e-4, column, wave)
