"""The fast solver: total-Lagrangian material points, a batch of equal bodies with their own loads."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from pneutac_sim.errors import InputError
from pneutac_sim.mpm import indenter as shapes
from pneutac_sim.mpm import lagrangian_kernels as kern
from pneutac_sim.mpm import lagrangian_steps as steps
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.rest_grid import RestGrid
from pneutac_sim.mpm.runtime import start, ti
from pneutac_sim.mpm.spine import Spine

CFL = 0.45
LARGE = 3000  # cells from which on one body is worth more than one thread
GPU_BLOCKS = 64  # of 256 lanes that any card since 2017 holds at once


@dataclass
class Loads:
    """What acts on each body of a batch.

    Attributes:
        q_cmd: (B, H) joint targets, rad.
        gravity: (3,) or (B, 3) m/s2.
        indenter: one of `indenter.SHAPES` or one a body.
        size_m: (3,) or (B, 3) m, see `indenter.distance`.
        position_m: (3,) or (B, 3) of the indenter's tip, m.
        rotation: (3, 3) or (B, 3, 3) of the indenter, whose body lies towards its own +z.
        friction: Coulomb's coefficient, or (B,).
    """

    q_cmd: np.ndarray | None = None
    gravity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    indenter: str | list[str] = "none"
    size_m: np.ndarray = field(default_factory=lambda: np.ones(3))
    position_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    friction: float | np.ndarray = 0.5


class TotalLagrangian:
    """A batch of bodies of one shape.

    Args:
        body: shape, material and clamped side.
        spine: of every body, or None.
        batch: number of bodies B.
        materials: one a body where they differ.
        device: see `runtime.start`.
        table: (n, n, n) signed distances (m) over a cube of half edge `size_m[0]` for the indenter `mesh`.
    """

    def __init__(
        self,
        body: Body,
        spine: Spine | None = None,
        batch: int = 1,
        materials: list[Material] | None = None,
        device: str = "auto",
        table: np.ndarray | None = None,
    ):
        self.device = start(device)
        self.body, self.spine, self.batch = body, spine, batch
        self.materials = materials or [body.material] * batch
        if len(self.materials) != batch:
            raise InputError(f"Body '{body.name}': {len(self.materials)} materials for a batch of {batch}.")
        self.grid = g = RestGrid.of(body)
        self.soa = self.device == "cuda"
        self.blocks = 1
        if self.soa:
            # As many as have work for their lanes, and as can be resident at once over all bodies.
            self.blocks = int(
                np.clip(len(g.cell_mask) * 8 // steps.GPU_LANES, 1, max(GPU_BLOCKS // batch, 1))
            )
        self.hinges = spine.hinges if spine else 0
        n = len(g.nodes)
        self.role = np.where(g.mirrored, -2, -1).astype(np.int32)
        link = np.full(n, -1)
        if spine:
            link = spine.bind(body, g)
            self.role[link >= 0] = link[link >= 0]
        self.bound = np.lexsort((np.arange(n), link))[(link < 0).sum() :]
        b, c, s, links = batch, len(g.cell_mask), len(g.surface_cell), self.hinges + 1
        z = np.zeros
        self.load = z((b, kern.LOAD), np.float32)
        mu, lam = np.array([m.lame for m in self.materials]).T
        rho = np.array([m.density_kg_m3 for m in self.materials])
        self.load[:, kern.MU], self.load[:, kern.LAM], self.load[:, kern.RHO] = mu, lam, rho
        self.sound_speed = np.array([m.sound_speed for m in self.materials])
        self.stable_dt = CFL * g.dx / self.sound_speed
        self.load[:, kern.DT] = self.stable_dt
        self.load[:, kern.SPRING] = 0.25 * (lam + 2 * mu) * g.dx
        table = np.zeros((2, 2, 2)) if table is None else table
        self.samples = len(table)
        lump = spine.lumps(g, link) if spine else z((1, 13))
        chain = spine.chain if spine else z((1, 6))
        pose = np.tile(np.concatenate([np.eye(3).ravel(), z(3)]), (b, links, 1))
        two = (lambda a: a.T) if self.soa else (lambda a: a)
        self.arrays = {
            name: _send(a)
            for name, a in {
                "load": self.load, "u": z((b, n, 3)), "v": z((b, n, 3)), "total": z((b, n, 3)),
                "force": z((b, c + 1, 27, 3)),
                "tensor": z((b, c if self.soa else steps.ROOM, 3, 24)), "spot_cell": g.surface_cell,
                "cell_nodes": two(g.cell_nodes), "cell_mask": g.cell_mask,
                "slots": two(g.slots), "ghost": g.ghost, "role": self.role, "volume": g.volume,
                "inertia": g.volume, "before": z((b, n, 3)), "soft": z((b, max(self.hinges, 1))),
                "rest": g.nodes, "start": g.surface_start, "spot": g.surface_points,
                "weights": g.surface_weights,
                "shape": z(b, np.int32), "table": table, "anchor": z((b, s, 5)), "contact": z((b, s, 4)),
                "q": z((b, max(self.hinges, 1))), "qd": z((b, max(self.hinges, 1))),
                "drive": z((b, max(self.hinges, 1), 3)), "chain": chain, "lump": lump, "pose": pose,
                "wrench": z((b, links, 6)), "momentum": z((b, links, 6)),
                "work": z((b, max(self.hinges, 1), self.hinges + 1)), "bound": self.bound.astype(np.int32),
                "bound_link": link[self.bound].astype(np.int32),
                "bound_start": np.searchsorted(link[self.bound], np.arange(links + 1)).astype(np.int32),
                "sums": z((b, 4)), "gate": z(b, np.int32),
            }.items()
        }  # fmt: skip
        self.counts = (b, c, n, s, self.hinges, len(self.bound))
        self.reset()
        self.apply(Loads())

    def reset(self) -> None:
        """Every body at rest, straight, untouched."""
        self.set_nodes(np.tile(self.grid.nodes, (self.batch, 1, 1)))
        self._set_q(np.zeros((self.batch, max(self.hinges, 1))))
        for name in ("anchor", "contact", "total"):
            self.arrays[name].fill(0)

    def set_nodes(self, x: np.ndarray) -> None:
        """Puts the nodes (B, N, 3) somewhere, at rest."""
        self.arrays["u"].from_numpy(self._flat(x - self.grid.nodes))
        self.arrays["v"].fill(0)

    def set_q(self, q: np.ndarray) -> None:
        """Puts the spine at angles (B, H) in rad, at rest, and carries the body along smoothly."""
        q = np.broadcast_to(np.asarray(q, float), (self.batch, self.hinges))
        x = self.spine.skin(q, self.grid.nodes)
        g = self.grid.ghost
        own = np.flatnonzero(g >= 0)
        x[:, g[own]] = self.grid.nodes[g[own]] - (x[:, own] - self.grid.nodes[own])
        self.set_nodes(x)
        self._set_q(q)

    def shift_q(self, q: np.ndarray) -> None:
        """Moves the spine to angles (B, H) and the body with it, from where they are."""
        g, own = self.grid.ghost, np.flatnonzero(self.grid.ghost >= 0)
        now = self.angles()[0].astype(float)
        x = self.nodes() + self.spine.skin(q, self.grid.nodes) - self.spine.skin(now, self.grid.nodes)
        x[:, g[own]] = self.grid.nodes[g[own]] - (x[:, own] - self.grid.nodes[own])
        self.set_nodes(x)
        self._set_q(q)

    def _set_q(self, q: np.ndarray) -> None:
        a = self.arrays
        a["q"].from_numpy(_line(q))
        a["qd"].fill(0)
        a["momentum"].fill(0)
        a["wrench"].fill(0)
        if self.spine:
            steps.place(
                *self.counts,
                self.soa,
                *(a[k] for k in ("q", "chain", "pose", "bound", "bound_link", "rest", "u")),
            )

    def apply(self, loads: Loads, damping=0.0, dt=None, contact_rate=0.0, drift_m=None) -> None:
        """Sets what acts from now on.

        Args:
            loads: of every body.
            damping: of the momentum, 1/s, or (B,).
            dt: step in s, or (B,); None for the largest stable one of each body.
            contact_rate: how fast penetration is pushed out, 1/s, or (B,).
            drift_m: (B, 3) by which the indenter moves in each substep, m.
        """
        k, b = kern, self.batch
        row = self.load
        row[:, k.GRAVITY : k.GRAVITY + 3] = loads.gravity
        row[:, k.POSE : k.POSE + 9] = np.broadcast_to(loads.rotation, (b, 3, 3)).reshape(b, 9)
        row[:, k.POSE + 9 : k.POSE + 12] = loads.position_m
        row[:, k.SIZE : k.SIZE + 3] = loads.size_m
        row[:, k.FRICTION] = loads.friction
        row[:, k.DRIFT : k.DRIFT + 3] = 0.0 if drift_m is None else drift_m
        row[:, k.RATE] = contact_rate
        row[:, k.DT] = self.stable_dt if dt is None else dt
        row[:, k.KEEP] = np.exp(-np.asarray(damping) * row[:, k.DT])
        if not np.isfinite(row).all():
            raise InputError(f"Body '{self.body.name}': a load is not a finite number.")
        if (row[:, k.DT] > 1.01 * self.stable_dt).any():
            raise InputError(
                f"Body '{self.body.name}': a step of {row[:, k.DT].max():.3g} s is too large for its speed "
                f"of sound ({self.sound_speed.max():.3g} m/s over {self.grid.dx:.3g} m); use at most "
                f"{self.stable_dt.min():.3g} s."
            )
        names = [loads.indenter] * b if isinstance(loads.indenter, str) else list(loads.indenter)
        unknown = set(names) - set(shapes.SHAPES)
        if unknown:
            raise InputError(f"There is no indenter '{unknown.pop()}'; there are {', '.join(shapes.SHAPES)}.")
        self.touching, self.taken = any(n != "none" for n in names), 0
        self.arrays["load"].from_numpy(_line(row))
        self.arrays["shape"].from_numpy(np.array([shapes.SHAPES.index(n) for n in names], np.int32))
        if self.spine:
            q = np.zeros(self.hinges) if loads.q_cmd is None else np.asarray(loads.q_cmd, float)
            if not np.isfinite(q).all():
                raise InputError(f"Body '{self.body.name}': a joint target is not a finite number.")
            drive = np.empty((b, self.hinges, 3), np.float32)
            drive[..., 0] = q
            self.drive_target = drive[..., 0].astype(float)
            drive[..., 1] = self.spine.stiffness_nm_per_rad
            drive[..., 2] = self.spine.damping_nms_per_rad
            self.arrays["drive"].from_numpy(_line(drive))

    def set_table(self, table: np.ndarray) -> None:
        """Sets the signed distances (n, n, n) of the indenter `mesh`, as many as there were."""
        self.arrays["table"].from_numpy(_line(table))

    def pace(self, rate: np.ndarray) -> None:
        """Sets critical damping of motions at `rate` (B,) in rad/s, and contact to settle as fast."""
        self.load[:, kern.RATE] = 2 * rate
        self.load[:, kern.KEEP] = np.exp(-2 * rate * self.load[:, kern.DT])
        self.arrays["load"].from_numpy(_line(self.load))

    def heavy_edges(self, on: bool) -> None:
        """Whether nodes that carry little material get the inertia of more.

        Where only the balance of forces counts this keeps them from rattling; true dynamics want it off.
        """
        least = 0.2 * self.grid.dx**3 if on else 0.0
        self.arrays["inertia"].from_numpy(_line(np.maximum(self.grid.volume, least)))

    def step(self, substeps: int) -> None:
        """Goes on by a number of substeps."""
        arrays = (self.arrays[k] for k in _ORDER)
        args = (*self.counts, self.grid.dx, self.samples, self.soa, self.touching, *arrays)
        if not self.soa and len(self.grid.cell_mask) >= LARGE and self.batch < 8:
            for i in range(substeps):
                steps.across(self.taken + i, *args)
        else:
            self.arrays["gate"].fill(0)
            steps.within(self.taken, substeps, self.blocks, self.arrays["gate"], *args)
        self.taken += substeps

    def measure(self) -> dict[str, np.ndarray]:
        """Tells, a body (B,): `residual`, `scale` (both N), `rate` (rad/s).

        `residual` is the norm of the forces on free nodes, `scale` that of the forces from outside (weight,
        contact, links of the spine), `rate` the frequency of the present motion by Rayleigh's quotient.
        """
        a = self.arrays
        names = ("load", "v", "total", "before", "contact", "role", "volume", "inertia", "sums")
        steps.measure(*self.counts, self.soa, *(a[k] for k in names))
        f2, kinetic, stiffness, outer = a["sums"].to_numpy().reshape(self.batch, 4).T.astype(float)
        dt = self.load[:, kern.DT]
        with np.errstate(invalid="ignore", divide="ignore"):
            rate = np.sqrt(np.maximum(stiffness / (dt * kinetic), 0.0))
        return {"residual": np.sqrt(f2), "scale": np.sqrt(outer), "rate": np.nan_to_num(rate)}

    def slowest_rate(self) -> np.ndarray:
        """(B,) rad/s: a guess of the lowest frequency, a shear wave over the furthest way to a hold."""
        held = self.grid.nodes[(self.role >= 0) | (self.grid.ghost >= 0)]
        free = self.grid.nodes[self.role == -1]
        far = np.ptp(free, axis=0).max()
        if len(held):
            far = max(float(cKDTree(held).query(free)[0].max()), self.grid.dx)
        shear = np.sqrt([m.lame[0] / m.density_kg_m3 for m in self.materials])
        return 0.5 * np.pi * shear / far

    def least_force(self) -> np.ndarray:
        """(B,) N: forces from outside below this count as none, like those of a strain of 1e-5 everywhere."""
        youngs = np.array([m.youngs_modulus_pa for m in self.materials])
        return 1e-5 * youngs * self.grid.dx**2 * np.sqrt(len(self.grid.cell_mask))

    def energy(self) -> np.ndarray:
        """(B,) kinetic energy of the nodes, J."""
        v = self._unflat(self.arrays["v"].to_numpy()).astype(float)
        rho = self.load[:, kern.RHO]
        return 0.5 * rho * (self.arrays["inertia"].to_numpy()[:, None] * v**2).sum((1, 2))

    def overlap(self) -> np.ndarray:
        """(B,) m: how deep the surface lies in the indenter; 0 where it does not."""
        steps.overlap(*self.counts, self.grid.dx, self.samples, self.soa, *(self.arrays[k] for k in _ORDER))
        depth = self.arrays["contact"].to_numpy().reshape(self.batch, -1, 4)[..., 3]
        return np.maximum(depth.max(1, initial=0.0), 0.0)

    def nodes(self) -> np.ndarray:
        """(B, N, 3) m."""
        return self.grid.nodes + self._unflat(self.arrays["u"].to_numpy())

    def particles(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, P, 3) positions in m and (B, P, 3, 3) deformation gradients."""
        count, a = len(self.body.cells), self.arrays
        if "place" not in a:
            a["particle_cell"], a["local"] = _send(self.grid.particle_cell), _send(self.grid.particle_local)
            a["place"] = _send(np.zeros((self.batch, count, 12)))
        names = ("u", "cell_nodes", "particle_cell", "local", "place")
        steps.particles(*self.counts, count, self.grid.dx, self.soa, *(a[k] for k in names))
        out = a["place"].to_numpy().reshape(self.batch, count, 12)
        return self.body.positions + out[..., :3], out[..., 3:].reshape(self.batch, count, 3, 3)

    def contact(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, S, 3) forces in N on the surface points and (B, S) their depth in the indenter in m."""
        c = self.arrays["contact"].to_numpy().reshape(self.batch, -1, 4)
        return c[..., :3], np.where(np.abs(c[..., :3]).sum(-1) > 0, c[..., 3], 0.0)

    def angles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(B, H) joint angles in rad, their rates in rad/s, torques of body and gravity on them in N m."""
        return tuple(
            self.arrays[k].to_numpy().reshape(self.batch, -1)[:, : self.hinges] for k in ("q", "qd", "soft")
        )

    def _flat(self, x):
        return _line(np.swapaxes(x, 1, 2) if self.soa else x)

    def _unflat(self, flat):
        b, n = self.batch, len(self.grid.nodes)
        return np.swapaxes(flat.reshape(b, 3, n), 1, 2) if self.soa else flat.reshape(b, n, 3)


def _line(a: np.ndarray) -> np.ndarray:
    a = np.ascontiguousarray(a)
    return (a if a.dtype == np.int32 else a.astype(np.float32)).ravel()


def _send(a: np.ndarray):
    flat = _line(a) if a.size else np.zeros(1, np.float32 if a.dtype != np.int32 else np.int32)
    out = ti.ndarray(dtype=ti.i32 if flat.dtype == np.int32 else ti.f32, shape=(len(flat),))
    out.from_numpy(flat)
    return out


_ORDER = (
    "load u v total before force tensor spot_cell "
    "cell_nodes cell_mask slots ghost role volume inertia rest start spot weights shape "
    "table anchor contact q qd drive chain lump pose wrench momentum work soft bound bound_link bound_start"
).split()
