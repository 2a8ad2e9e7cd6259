"""A soft body at rest: particles on a regular lattice inside a closed mesh, their grid and their material.

Grid spacing is twice the particles', so a full cell holds eight of them, at a quarter and three quarters of
its edges. With quadratic splines all eight share the same 27 nodes, and their weights are products of the
numbers below.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.user_mesh import lattice_inside

SPACINGS = np.linspace(-0.08, 0.08, 33)  # tried, off the one that volume and number of particles give
GOOD = 0.01  # relative error at which the search ends


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

    @staticmethod
    def box(name, counts, spacing_m, material, origin_m=(0.0, 0.0, 0.0), clamp="") -> "Body":
        """A block of `counts` (3,) particles along x, y, z with its least corner at `origin_m`."""
        counts = np.asarray(counts, int)
        if counts.shape != (3,) or (counts < 1).any():
            raise InputError(f"Body '{name}': counts is {counts.tolist()}; give three positive numbers.")
        grid = np.argwhere(np.ones(counts, bool))
        return _make(name, grid, spacing_m, np.asarray(origin_m, float), material, clamp)

    @staticmethod
    def from_mesh(name, mesh, material, particles: float = 4000, clamp="", search=False) -> "Body":
        """Fills a closed `trimesh.Trimesh` in m, its normals outward, with about so many particles.

        With `search` it takes the lattice that errs least in number of particles and in volume. Both jump
        with the spacing, as a section is so many whole particles wide: spacings, and one particle more or
        less across, are tried, the nearest spacing first.

        Raises InputError where the mesh is open or turned inside out, or holds no particle.
        """
        volume = float(mesh.volume) if mesh.is_watertight else 0.0
        if not volume > 0:
            raise InputError(
                f"Body '{name}': the mesh is open, empty or turned inside out, so it has no inside; close it"
                " with trimesh.repair.fill_holes, or turn it with mesh.invert()."
            )
        triangles = np.ascontiguousarray(mesh.triangles, float)
        low, high = mesh.bounds
        best, least = None, np.inf
        for step in sorted(SPACINGS, key=abs) if search else [0.0]:
            h = (1 + step) * (volume / particles) ** (1 / 3)
            whole = (high - low) / h
            ways = [{round(whole[0])}, *({int(n), int(n) + 1} if search else {round(n)} for n in whole[1:])]
            for counts in product(*map(sorted, ways)):
                counts = np.maximum(counts, 1)
                origin = (low + high) / 2 - counts * h / 2
                cells = np.argwhere(lattice_inside(triangles, origin, counts, h))
                error = max(abs(len(cells) / particles - 1), abs(len(cells) * h**3 / volume - 1))
                if error < least:
                    best, least = (cells, h, origin), error
            if least < GOOD:
                break
        if best is None or not len(best[0]):
            raise InputError(f"Body '{name}': no particle lies inside the mesh; ask for more, in metres.")
        return _make(name, *best, material, clamp)


def _make(name, cells, spacing_m, origin_m, material, clamp) -> Body:
    if not (np.isfinite(spacing_m) and spacing_m > 0):
        raise InputError(f"Body '{name}': spacing_m is {spacing_m}; it must be a positive number.")
    if clamp not in ("", "x-", "y-", "z-"):
        raise InputError(f"Body '{name}': clamp is '{clamp}'; choose x-, y-, z- or nothing.")
    least = cells.min(0)  # a cell of the grid must begin at the clamped side
    origin_m = origin_m + least * spacing_m
    return Body(name, (cells - least).astype(np.int32), float(spacing_m), origin_m, clamp, material)


# Spline weight of nodes 0, 1, 2 and its derivative (per grid spacing) at the two particles of a cell.
WEIGHT = np.array([[0.28125, 0.6875, 0.03125], [0.03125, 0.6875, 0.28125]])
SLOPE = np.array([[-0.75, 0.5, 0.25], [-0.25, -0.5, 0.75]])


def spline(f: np.ndarray) -> np.ndarray:
    """(..., 3) weights of nodes 0, 1, 2 at distance f in [0.5, 1.5] from node 0, in grid spacings."""
    return np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], -1)


@dataclass(frozen=True)
class RestGrid:
    """A body's cells and nodes.

    Attributes:
        dx: grid spacing, m.
        nodes: (N, 3) rest positions of the nodes that the body touches, m.
        volume: (N,) material volume that each node carries, m3.
        cell_nodes: (C, 27) node of each cell's corner, index 9 i + 3 j + k.
        cell_mask: (C,) int bits: particle 4 i + 2 j + k of the cell exists.
        slots: (N, 27) cell whose local node a this node is; C where there is none.
        ghost: (N,) node beyond the clamped side that mirrors this one, -1 for none: it moves the opposite
        way, so that the side itself stands still.
        mirrored: (N,) bool: this node is such a ghost.
        particle_cell: (P,) cell of each particle.
        particle_local: (P,) its number in the cell.
        surface_cell: (S,) cell of each point of the body's surface, sorted.
        surface_weights: (S, 3, 3) spline weights along x, y, z.
        surface_points: (S, 3) at rest, m.
        surface_start: (C + 1,) first surface point of each cell.
    """

    dx: float
    nodes: np.ndarray
    volume: np.ndarray
    cell_nodes: np.ndarray
    cell_mask: np.ndarray
    slots: np.ndarray
    ghost: np.ndarray
    mirrored: np.ndarray
    particle_cell: np.ndarray
    particle_local: np.ndarray
    surface_cell: np.ndarray
    surface_weights: np.ndarray
    surface_points: np.ndarray
    surface_start: np.ndarray

    @staticmethod
    def of(body: Body) -> "RestGrid":
        dx = 2 * body.spacing_m
        cell, local = body.cells // 2, body.cells % 2
        cells, index = np.unique(cell, axis=0, return_inverse=True)
        index = index.ravel()
        number = local @ np.array([4, 2, 1])
        mask = np.zeros(len(cells), np.int32)
        np.bitwise_or.at(mask, index, 1 << number.astype(np.int32))
        # Node (i, j, k) of the grid lies at the middle of cell (i - 1, j - 1, k - 1): a quadratic spline's
        # three nearest nodes are the middles of its own cell and of the two neighbours.
        offset = np.stack(np.meshgrid(*(np.arange(3),) * 3, indexing="ij"), -1).reshape(27, 3)
        corner = cells[:, None] + offset
        nodes, node_of = np.unique(corner.reshape(-1, 3), axis=0, return_inverse=True)
        node_of = node_of.reshape(-1, 27).astype(np.int32)
        slots = np.full((len(nodes), 27), len(cells), np.int32)
        slots[node_of, np.arange(27)] = np.arange(len(cells))[:, None]
        w = WEIGHT[local]  # (P, 3 axes, 3 nodes)
        # V_i = sum_p w_ip V_p, w_ip the product of the axes' splines
        share = np.einsum("pa,pb,pc->pabc", w[:, 0], w[:, 1], w[:, 2]).reshape(-1, 27)
        volume = np.zeros(len(nodes))
        np.add.at(volume, node_of[index], share * body.spacing_m**3)
        ghost = np.full(len(nodes), -1, np.int32)
        mirrored = np.zeros(len(nodes), bool)
        if body.clamp:
            axis = "xyz".index(body.clamp[0])
            mirrored = nodes[:, axis] == 0
            step = np.eye(3, dtype=int)[axis]
            place = {tuple(n): i for i, n in enumerate(nodes)}
            for i in np.flatnonzero(mirrored):
                ghost[place[tuple(nodes[i] + step)]] = i
        surface = _surface(body, cells, index)
        return RestGrid(
            dx=dx,
            nodes=body.origin_m + (nodes - 0.5) * dx,
            volume=volume,
            cell_nodes=node_of,
            cell_mask=mask,
            slots=slots,
            ghost=ghost,
            mirrored=mirrored,
            particle_cell=index.astype(np.int32),
            particle_local=number.astype(np.int32),
            **surface,
        )


def _surface(body: Body, cells: np.ndarray, index: np.ndarray) -> dict[str, np.ndarray]:
    """One point on each outer face of the lattice, sorted by cell."""
    taken = {tuple(c) for c in body.cells}
    owners, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            step = np.zeros(3, int)
            step[axis] = sign
            bare = np.array([tuple(c) not in taken for c in body.cells + step], bool)
            owners.append(np.flatnonzero(bare))
            normals.append(np.tile(step, (bare.sum(), 1)))
    owner, normal = np.concatenate(owners), np.concatenate(normals)
    if body.clamp:
        axis = "xyz".index(body.clamp[0])
        keep = ~((normal[:, axis] == -1) & (body.cells[owner, axis] == 0))
        owner, normal = owner[keep], normal[keep]
    order = np.argsort(index[owner], kind="stable")
    owner, normal = owner[order], normal[order]
    cell = index[owner]
    # 0.75 or 1.25 grid spacings from node 0 for a particle; a face is a quarter spacing further out.
    place = 0.75 + 0.5 * (body.cells[owner] % 2) + 0.25 * normal
    return {
        "surface_cell": cell.astype(np.int32),
        "surface_weights": spline(place).astype(np.float32),
        "surface_points": body.positions[owner] + 0.5 * body.spacing_m * normal,
        "surface_start": np.searchsorted(cell, np.arange(len(cells) + 1)).astype(np.int32),
    }
