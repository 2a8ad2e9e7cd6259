"""A soft body at rest: particles on a regular lattice inside a closed mesh, their grid and their material.

Grid spacing is twice the particles', so a full cell holds eight of them, at a quarter and three quarters of
its edges. With quadratic splines all eight share the same 27 nodes, and their weights are products of the
numbers below.

The spine: rigid links with hinges in the neutral axis of a body, driven by a controller.
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
    """Neo-Hookean solid, P = mu (F - F^-T) + lambda ln(J) F^-T."""

    youngs_modulus_pa: float  # at small strain, Pa
    poissons_ratio: float  # in [0, 0.495]: above, an explicit step gets too small to be of use
    density_kg_m3: float = 1100.0  # kg/m3

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
    """Particles of a body at rest."""

    name: str  # shown in errors
    cells: np.ndarray  # (P, 3) int lattice coordinates of the particles
    spacing_m: float  # of the lattice, m; each particle stands for spacing^3 of material
    origin_m: np.ndarray  # (3,) m; particle position = origin + (cells + 1/2) spacing
    # side of the body that is held, `x-`, `y-` or `z-` (the least x, y, z of the lattice), or empty
    clamp: str
    material: Material  # neo-Hookean solid

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
    """A body's cells and nodes."""

    dx: float  # grid spacing, m
    nodes: np.ndarray  # (N, 3) rest positions of the nodes that the body touches, m
    volume: np.ndarray  # (N,) material volume that each node carries, m3
    cell_nodes: np.ndarray  # (C, 27) node of each cell's corner, index 9 i + 3 j + k
    cell_mask: np.ndarray  # (C,) int bits: particle 4 i + 2 j + k of the cell exists
    slots: np.ndarray  # (N, 27) cell whose local node a this node is; C where there is none
    # (N,) node beyond the clamped side that mirrors this one, -1 for none: it moves the opposite way, so that
    # the side itself stands still
    ghost: np.ndarray
    mirrored: np.ndarray  # (N,) bool: this node is such a ghost
    particle_cell: np.ndarray  # (P,) cell of each particle
    particle_local: np.ndarray  # (P,) its number in the cell
    surface_cell: np.ndarray  # (S,) cell of each point of the body's surface, sorted
    surface_weights: np.ndarray  # (S, 3, 3) spline weights along x, y, z
    surface_points: np.ndarray  # (S, 3) at rest, m
    surface_start: np.ndarray  # (C + 1,) first surface point of each cell

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
        places, particles = (
            body.origin_m + (nodes - 0.5) * dx,
            (index.astype(np.int32), number.astype(np.int32)),
        )
        of_nodes = places, volume, node_of, mask, slots, ghost, mirrored
        return RestGrid(dx, *of_nodes, *particles, **_surface(body, cells, index))


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


@dataclass(frozen=True)
class Spine:
    """A chain of hinges along x; a positive angle bends towards +z (and, with two axes, towards +y).

    Torque of the controller: stiffness (q_cmd - q) - damping q'.
    """

    joint_positions_m: tuple[float, ...]  # (N,) along x, m
    length_m: float  # where the last link ends, m
    y_m: float  # of the axis, m
    z_m: float  # of the axis, m
    radius_m: float  # nodes of the body within this distance of the axis move with the links, m
    axes: int = 1  # hinges a joint: 1 (in the plane) or 2
    stiffness_nm_per_rad: float = 10.0  # of the controller
    damping_nms_per_rad: float = 0.01  # of the controller
    cap_m: float = 0.0  # length at the far end over which the whole body moves with the last link, m

    def __post_init__(self):
        places = np.asarray(self.joint_positions_m, float)
        if places.ndim != 1 or len(places) < 1 or (np.diff(places) <= 0).any() or places[0] < 0:
            raise InputError(
                f"Spine: joint_positions_m is {places.tolist()}; give positions from base to tip, ascending."
            )
        if not self.length_m > places[-1]:
            raise InputError(
                f"Spine: length_m is {self.length_m}; it must exceed the last joint's {places[-1]} m."
            )
        if self.axes not in (1, 2):
            raise InputError(f"Spine: axes is {self.axes}; choose 1 (finger) or 2 (arm).")
        for name in ("radius_m", "stiffness_nm_per_rad"):
            if not getattr(self, name) > 0:
                raise InputError(f"Spine: {name} is {getattr(self, name)}; it must be positive.")
        if not 0 <= self.cap_m <= self.length_m - places[-1]:
            raise InputError(
                f"Spine: cap_m is {self.cap_m}; it must lie between 0 and the last link's length."
            )

    @property
    def hinges(self) -> int:
        """Number of hinges: joints times axes, numbered joint by joint, towards +z first."""
        return len(self.joint_positions_m) * self.axes

    @property
    def chain(self) -> np.ndarray:
        """(H, 6) origin (m) and axis of each hinge at rest."""
        rows = []
        for x in self.joint_positions_m:
            for axis in ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0))[: self.axes]:
                rows.append((x, self.y_m, self.z_m, *axis))
        return np.array(rows)

    def bind(self, body: Body, grid: RestGrid) -> np.ndarray:
        """(N,) link that carries each node, -1 for none; link 0 stands still.

        Raises InputError where a link lies outside the body.
        """
        away = np.hypot(grid.nodes[:, 1] - self.y_m, grid.nodes[:, 2] - self.z_m)
        x = grid.nodes[:, 0]
        inside = (away <= self.radius_m) & (x <= self.length_m) & ~grid.mirrored
        inside &= grid.volume > 0.25 * grid.dx**3  # the others are at the edge of a cell that is nearly empty
        link = np.searchsorted(np.asarray(self.joint_positions_m), x) * self.axes
        link = np.where(inside, link, -1)
        if self.cap_m:
            capped = (x >= self.length_m - self.cap_m) & (grid.volume > 0) & ~grid.mirrored
            link = np.where(capped, self.hinges, link)
        for joint in range(len(self.joint_positions_m)):
            if not (link == (joint + 1) * self.axes).any():
                raise InputError(
                    f"Body '{body.name}': the spine's link after joint {joint + 1} (x from "
                    f"{self.joint_positions_m[joint]:.4g} m, y {self.y_m:.4g} m, z {self.z_m:.4g} m, radius "
                    f"{self.radius_m:.4g} m) lies outside the body; move the axis inside or "
                    "use a larger radius."
                )
        return link.astype(np.int32)

    def poses(self, q: np.ndarray) -> np.ndarray:
        """(..., H + 1, 3, 4) rotation and shift of each link at joint angles `q` (..., H) in rad."""
        q = np.asarray(q, float)
        out = np.zeros((*q.shape[:-1], self.hinges + 1, 3, 4))
        out[..., 0, :, :3] = np.eye(3)
        for h, row in enumerate(self.chain):
            a = row[3:]
            K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
            s, c = np.sin(q[..., h, None, None]), np.cos(q[..., h, None, None])
            R, t = out[..., h, :, :3], out[..., h, :, 3]
            # Rodrigues: R <- R (1 + sin q K + (1 - cos q) K^2), about the hinge's origin
            turned = R @ (np.eye(3) + s * K + (1 - c) * (K @ K))
            out[..., h + 1, :, :3] = turned
            out[..., h + 1, :, 3] = np.einsum("...ij,j->...i", R - turned, row[:3]) + t
        return out

    def lumps(self, grid: RestGrid, link: np.ndarray) -> np.ndarray:
        """(H + 1, 13) mass, centre (m) and inertia about it of each link's nodes, at unit density."""
        out = np.zeros((self.hinges + 1, 13))
        for i in range(self.hinges + 1):
            m, p = grid.volume[link == i], grid.nodes[link == i]
            if not len(m):
                continue
            centre = (m[:, None] * p).sum(0) / m.sum()
            r = p - centre
            spread = (m[:, None] * r).T @ r
            inertia = np.trace(spread) * np.eye(3) - spread  # sum m (|r|^2 1 - r r^T)
            out[i] = np.concatenate([[m.sum()], centre, inertia.ravel()])
        return out

    def skin(self, q: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(..., P, 3) rest points (P, 3), m, carried along smoothly by the links at angles (..., H) rad.

        It starts the search of equilibrium. Between the middles of two links poses are blended linearly.
        """
        poses = self.poses(q)[..., :: self.axes, :, :]
        ends = np.concatenate([[0.0], self.joint_positions_m, [self.length_m]])
        middle = (ends[:-1] + ends[1:]) / 2
        place = np.clip(np.interp(points[:, 0], middle, np.arange(len(middle))), 0, len(middle) - 1)
        low = np.minimum(place.astype(int), len(middle) - 2)
        w = (place - low)[:, None, None]
        blend = (1 - w) * poses[..., low, :, :] + w * poses[..., low + 1, :, :]
        return np.einsum("...pij,pj->...pi", blend[..., :3], points) + blend[..., 3]
