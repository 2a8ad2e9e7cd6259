"""Force of the gel on what presses it, from the gel's material: one law for probe grid and world.

The gel is an isotropic layer of thickness t, Young's modulus E and Poisson's ratio nu, bonded to its window.
A pressure wave p e^{ikx} moves its face by C(k) p e^{ikx} into the gel, with G = E / (2 (1 + nu)),

    C(k) = (1 - nu) / (G k) * (2 K sinh 2z - 4 z) / (2 K cosh 2z + 1 + K^2 + 4 z^2),  z = k t,  K = 3 - 4 nu

(Johnson, Contact Mechanics, Sec. 5.8). Short waves see a half-space, a uniform pressure a column that cannot
widen. With d the imprint and g = C * p - d the gap, the contact without friction is

    p >= 0,  g >= 0,  p g = 0,

solved by conjugate gradients on the points that carry pressure (Polonsky & Keer, Wear 231, 1999). Force:

    F = (1 + 0.785 e b) sum w p,   e = sum p d / (t sum p),   b = a / t,   pi a^2 = (sum p)^2 / sum p^2,
    w = product over the four sides of 1 - 0.64 exp(-s / 0.47 t),   s the way to that side.

Without w the sum is Hertz for a small contact; w is what the gel bulges out at its free sides. The bracket is
what a linear layer lacks once it is pressed by a share e of its thickness over a radius a: a face that sticks
keeps an almost incompressible gel from flowing away. The three numbers are fitted to material points with
friction, see `benchmarks/notes/gel_force.md`.

What a gel is made of.
"""

import math

import numpy as np
from scipy import fft

from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.twin import Twin

# Of a gel whose twin has none: Ecoflex 00-31 with a coat of paint, about 0.1 MPa.
MODULUS = "gel_youngs_modulus_mpa"
MATERIAL = {MODULUS: 0.1, "gel_poissons_ratio": 0.46}
# Beyond these a gel is no rubber.
MODULUS_MPA, POISSONS_RATIO = (0.005, 2.0), (0.0, 0.495)


STICKS = 0.785
RIM, RIM_SHARE = 0.64, 0.47  # of the force at a side; of the thickness, over which that fades
TOLERANCE = 1e-3  # of the depth: largest gap or overlap, relative, at which the search ends
FINEST_MM = 1e-5  # single precision resolves no finer gap
MAX_ITERATIONS = 200


class GelForce:
    """The law of one gel.

    Attributes:
        window_mm, thickness_mm: of the layer.
        shear_modulus_mpa, poissons_ratio: G and nu.
    """

    def __init__(
        self,
        window_mm: tuple[float, float],
        thickness_mm: float,
        youngs_modulus_mpa: float,
        poissons_ratio: float,
        shape: tuple[int, int] = (ROWS, COLS),
    ):
        """A gel at rest, of a window (width, height), E and nu, whose imprints have `shape` (rows, columns).

        Raises InputError where modulus or ratio are not those of a rubber.
        """
        for name, value, (low, high) in (
            (MODULUS, youngs_modulus_mpa, MODULUS_MPA),
            ("gel_poissons_ratio", poissons_ratio, POISSONS_RATIO),
        ):
            if not low <= value <= high:
                raise InputError(
                    f"The twin's {name} is {value:g}; the force of a gel is known from {low:g} to {high:g}: "
                    "correct it in the twin."
                )
        self.window_mm, self.thickness_mm, self._shape = window_mm, thickness_mm, shape
        self.shear_modulus_mpa = youngs_modulus_mpa / (2 * (1 + poissons_ratio))
        self.poissons_ratio = poissons_ratio
        self._cell = window_mm[1] / shape[0], window_mm[0] / shape[1]
        # The layer forgets within about three thicknesses, so that padding keeps its periodic images apart.
        self._padded = tuple(
            fft.next_fast_len(n + math.ceil(3 * thickness_mm / h), real=True)
            for n, h in zip(shape, self._cell, strict=True)
        )
        ky = 2 * np.pi * fft.fftfreq(self._padded[0], self._cell[0])
        kx = 2 * np.pi * fft.rfftfreq(self._padded[1], self._cell[1])
        y, x = ((np.arange(n) + 0.5) * h for n, h in zip(shape, self._cell, strict=True))
        self._held = rim(window_mm[1], thickness_mm, y)[:, None] * rim(window_mm[0], thickness_mm, x)
        k = np.hypot(ky[:, None], kx[None, :])
        self._compliance = compliance(k, thickness_mm, poissons_ratio, self.shear_modulus_mpa)
        self._compliance = self._compliance.astype(np.float32)

    @classmethod
    def of(cls, twin: Twin) -> "GelForce":
        """The law of the gel of a twin, with the size that it has as material points: whole layers of them.

        Raises InputError: as the constructor.
        """
        E, nu = (twin.parameters[k].value if k in twin.parameters else v for k, v in MATERIAL.items())
        model = GelModel.from_twin(twin)
        spacing = max(model.cell_mm)
        layers = math.ceil(model.thickness_mm / spacing - 1e-6)
        return cls((COLS * spacing, ROWS * spacing), layers * spacing, E, nu)

    def force(self, depth_mm: np.ndarray) -> float:
        """Force in N under an imprint, how deep objects lie (rows, columns) in mm; milliseconds.

        Raises InputError where the imprint has another shape.
        """
        p, d = self.pressure(depth_mm).astype(float), np.asarray(depth_mm, float)
        if not p.any():
            return 0.0
        area = p.sum() ** 2 / (p * p).sum() * self._cell[0] * self._cell[1]
        linear = (self._held * p).sum() * self._cell[0] * self._cell[1]
        return linear * (1 + sticking((p * d).sum() / p.sum(), area, self.thickness_mm))

    def pressure(self, depth_mm: np.ndarray) -> np.ndarray:
        """Pressure of the linear layer, MPa, float32 (rows, columns); as `force`."""
        if depth_mm.shape != self._shape:
            raise InputError(f"The imprint has shape {depth_mm.shape}; the gel's is {self._shape}.")
        d = np.asarray(depth_mm, np.float32)
        p = d.copy()
        if not p.any():
            return p
        p *= np.vdot(p, d) / np.vdot(p, self._move(p))  # the best multiple of the imprint
        return self._solve(p, d, max(TOLERANCE * float(d.max()), FINEST_MM))

    def _solve(self, p: np.ndarray, d: np.ndarray, tolerance: float) -> np.ndarray:
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
        wave = fft.rfft2(p, self._padded)
        wave *= self._compliance
        return fft.irfft2(wave, self._padded, overwrite_x=True)[: self._shape[0], : self._shape[1]]


def rim(size_mm: float, thickness_mm: float, at_mm: np.ndarray) -> np.ndarray:
    """Share of the force left at a distance `at_mm` (n,) from one of two sides `size_mm` apart, (n,)."""
    fades = RIM_SHARE * thickness_mm
    return (1 - RIM * np.exp(-at_mm / fades)) * (1 - RIM * np.exp((at_mm - size_mm) / fades))


def sticking(depth_mm: float, area_mm2: float, thickness_mm: float) -> float:
    """0.785 e b, what sticking adds to the linear layer's force, of mean depth and area of the contact."""
    return STICKS * depth_mm * math.sqrt(area_mm2 / math.pi) / thickness_mm**2


def compliance(
    k_per_mm: np.ndarray, thickness_mm: float, poissons_ratio: float, shear_modulus_mpa: float
) -> np.ndarray:
    """C(k) in mm/MPa: displacement of the face over a pressure wave of wave number k in rad/mm."""
    nu, G, K = poissons_ratio, shear_modulus_mpa, 3 - 4 * poissons_ratio
    z = np.maximum(k_per_mm, 1e-9) * thickness_mm
    short = np.exp(-2 * z)  # both sides of the fraction times e^{-2z}: nothing overflows
    over = K * (1 - short**2) - 4 * z * short
    under = K * (1 + short**2) + (1 + K**2 + 4 * z**2) * short
    wave = (1 - nu) * thickness_mm / (G * z) * over / under
    column = thickness_mm * (1 - 2 * nu) / (2 * G * (1 - nu))
    return np.where(z < 1e-4, column, wave)
