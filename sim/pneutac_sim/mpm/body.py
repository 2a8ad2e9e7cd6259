"""A soft body at rest: particles on a regular lattice inside a closed mesh, and its material."""

from dataclasses import dataclass

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.user_mesh import lattice_inside, lattice_of


@dataclass(frozen=True)
class Material:
    """Neo-Hookean solid, P = mu (F - F^-T) + lambda ln(J) F^-T.

    Attributes:
        youngs_modulus_pa: at small strain, Pa.
        poissons_ratio: in [0, 0.495]: above, an explicit step gets too small to be of use.
        density_kg_m3: kg/m3.
    """

    youngs_modulus_pa: float
    poissons_ratio: float
    density_kg_m3: float = 1100.0

    def __post_init__(self):
        for name in ("youngs_modulus_pa", "density_kg_m3"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"Material: {name} is {value}; it must be a positive number.")
        if not (np.isfinite(self.poissons_ratio) and 0 <= self.poissons_ratio <= 0.495):
            raise InputError(
                f"Material: poissons_ratio is {self.poissons_ratio}; it must lie in [0, 0.495] (0.5 is "
                "incompressible, which this method cannot do)."
            )

    @property
    def lame(self) -> tuple[float, float]:
        """Shear modulus mu and Lame's first parameter lambda, Pa."""
        e, nu = self.youngs_modulus_pa, self.poissons_ratio
        return e / (2 * (1 + nu)), e * nu / ((1 + nu) * (1 - 2 * nu))

    @property
    def sound_speed(self) -> float:
        """Of pressure waves, m/s: sqrt((lambda + 2 mu) / rho)."""
        mu, lam = self.lame
        return float(np.sqrt((lam + 2 * mu) / self.density_kg_m3))


@dataclass(frozen=True)
class Body:
    """Particles of a body at rest.

    Attributes:
        name: shown in errors.
        cells: (P, 3) int lattice coordinates of the particles.
        spacing_m: of the lattice, m; each particle stands for spacing^3 of material.
        origin_m: (3,) m; particle position = origin + (cells + 1/2) spacing.
        clamp: side of the body that is held, `x-`, `y-` or `z-` (the least x, y, z of the lattice), or empty.
        material: neo-Hookean solid.
    """

    name: str
    cells: np.ndarray
    spacing_m: float
    origin_m: np.ndarray
    clamp: str
    material: Material

    @property
    def positions(self) -> np.ndarray:
        """(P, 3) at rest, m."""
        return self.origin_m + (self.cells + 0.5) * self.spacing_m

    @property
    def volume_m3(self) -> float:
        """Volume of all particles, m3."""
        return len(self.cells) * self.spacing_m**3

    @staticmethod
    def box(name, counts, spacing_m, material, origin_m=(0.0, 0.0, 0.0), clamp="") -> "Body":
        """A block of `counts` (3,) particles along x, y, z with its least corner at `origin_m`."""
        counts = np.asarray(counts, int)
        if counts.shape != (3,) or (counts < 1).any():
            raise InputError(f"Body '{name}': counts is {counts.tolist()}; give three positive numbers.")
        grid = np.argwhere(np.ones(counts, bool))
        return _make(name, grid, spacing_m, np.asarray(origin_m, float), material, clamp)

    @staticmethod
    def from_mesh(name, mesh, material, particles: int = 4000, spacing_m=None, clamp="") -> "Body":
        """Fills a closed `trimesh.Trimesh` in m with about so many particles, or at a spacing.

        Raises InputError where the mesh is open, turned inside out, or holds no particle.
        """
        if not mesh.is_watertight:
            raise InputError(
                f"Body '{name}': the mesh is open, so it has no inside; close it (for example with "
                "trimesh.repair.fill_holes) first."
            )
        if mesh.volume <= 0:
            raise InputError(
                f"Body '{name}': the mesh is empty or turned inside out (volume {mesh.volume:.3g} m3); "
                "mesh.invert() turns it."
            )
        h = spacing_m or float((mesh.volume / particles) ** (1 / 3))
        origin, counts = lattice_of(mesh, h)
        cells = np.argwhere(lattice_inside(mesh.triangles, origin, counts, h))
        if not len(cells):
            raise InputError(
                f"Body '{name}': no particle lies inside the mesh; it is {mesh.extents} m large and the "
                f"spacing {h:.3g} m: use a smaller spacing, and metres."
            )
        return _make(name, cells, h, origin, material, clamp)


def _make(name, cells, spacing_m, origin_m, material, clamp) -> Body:
    if not (np.isfinite(spacing_m) and spacing_m > 0):
        raise InputError(f"Body '{name}': spacing_m is {spacing_m}; it must be a positive number.")
    if clamp not in ("", "x-", "y-", "z-"):
        raise InputError(f"Body '{name}': clamp is '{clamp}'; choose x-, y-, z- or nothing.")
    least = cells.min(0)  # a cell of the grid must begin at the clamped side
    origin_m = origin_m + least * spacing_m
    return Body(name, (cells - least).astype(np.int32), float(spacing_m), origin_m, clamp, material)
