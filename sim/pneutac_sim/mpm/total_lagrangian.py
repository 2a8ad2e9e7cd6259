"""The fast solver: total-Lagrangian material points, a batch of equal bodies with their own loads."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from pneutac_sim.errors import InputError
from pneutac_sim.mpm import kernels as steps
from pneutac_sim.mpm.body import Body, Material, RestGrid, Spine
from pneutac_sim.mpm.indenter import SHAPES
from pneutac_sim.mpm.runtime import start


@dataclass
class Loads:
    """What acts on each body of a batch."""

    q_cmd: np.ndarray | None = None  # (B, H) joint targets, rad
    gravity: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) or (B, 3) m/s2
    indenter: str | list[str] = "none"  # one of `indenter.SHAPES` or one a body
    # (3,) or (B, 3) m, see `indenter.distance`
    size_m: np.ndarray = field(default_factory=lambda: np.ones(3))
    # (3,) or (B, 3) of the indenter's tip, m
    position_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # (3, 3) or (B, 3, 3) of the indenter, whose body lies towards its own +z
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    friction: float | np.ndarray = 0.5  # Coulomb's coefficient, or (B,)

    def fill(self, row: np.ndarray) -> None:
        """Writes itself into the rows (B, LOAD) that the kernels read."""
        batch = len(row)
        row[:, steps.GRAVITY : steps.GRAVITY + 3] = self.gravity
        row[:, steps.POSE : steps.POSE + 9] = np.broadcast_to(self.rotation, (batch, 3, 3)).reshape(batch, 9)
        row[:, steps.POSE + 9 : steps.POSE + 12] = self.position_m
        row[:, steps.SIZE : steps.SIZE + 3] = self.size_m
        row[:, steps.FRICTION] = self.friction

    def shapes(self, batch: int) -> np.ndarray:
        """(B,) number of each body's indenter; raises InputError where there is no such indenter."""
        names = [self.indenter] * batch if isinstance(self.indenter, str) else list(self.indenter)
        unknown = set(names) - set(SHAPES)
        if unknown:
            raise InputError(f"There is no indenter '{unknown.pop()}'; there are {', '.join(SHAPES)}.")
        return np.array([SHAPES.index(n) for n in names], np.int32)

    def targets(self, batch: int, hinges: int) -> np.ndarray:
        """(B, H) rad, nothing where none were given."""
        return np.broadcast_to(0.0 if self.q_cmd is None else np.asarray(self.q_cmd, float), (batch, hinges))


CFL = 0.45
LARGE = 3000  # cells from which on one body is worth more than one thread
GPU_BLOCKS = 64  # of 256 lanes that any card since 2017 holds at once


class TotalLagrangian:
    """A batch of bodies of one shape, material and clamped side; `materials`, one a body, where they differ.

    Each has a spine or none. `table` (n, n, n) are signed distances in m over a cube of half edge
    `size_m[0]`, for the indenter `mesh`.
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
        self.hinges = spine.hinges if spine else 0
        self._set_materials()
        self.soa = self.device == "cuda"
        self.blocks = 1
        if self.soa:
            # As many as have work for their lanes, and as can be resident at once over all bodies.
            self.blocks = int(
                np.clip(len(g.cell_mask) * 8 // steps.GPU_LANES, 1, max(GPU_BLOCKS // batch, 1))
            )
        link = spine.bind(body, g) if spine else np.full(len(g.nodes), -1)
        table = np.zeros((2, 2, 2)) if table is None else table
        host = steps.contents(g, spine, link, self.load, table, self.soa)
        self.role = host["role"]
        self.arrays = {name: steps.send(a) for name, a in host.items() if isinstance(a, np.ndarray)}
        self.state = steps.State(**host | self.arrays)
        self.sums, self.gate = steps.send(np.zeros((batch, 4))), steps.send(np.zeros(batch, np.int32))
        self._particles: list | None = None  # on the device, once asked for
        self.reset()
        self.apply(Loads())

    def _set_materials(self) -> None:
        """Writes the materials' columns of `load`, and the largest stable step of each body."""
        self.load = np.zeros((self.batch, steps.LOAD), np.float32)
        mu, lam = np.array([m.lame for m in self.materials]).T
        self.sound_speed = np.array([m.sound_speed for m in self.materials])
        self.stable_dt = CFL * self.grid.dx / self.sound_speed  # Courant, Friedrichs, Lewy
        self.load[:, steps.MU], self.load[:, steps.LAM] = mu, lam
        self.load[:, steps.RHO] = [m.density_kg_m3 for m in self.materials]
        self.load[:, steps.DT] = self.stable_dt
        # Stiff enough that contact is as stiff as the material behind it, a quarter of its P-wave modulus.
        self.load[:, steps.SPRING] = 0.25 * (lam + 2 * mu) * self.grid.dx

    def reset(self) -> None:
        """Puts every body at rest, straight and untouched."""
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
        self._put(self.spine.skin(q, self.grid.nodes), q)

    def shift_q(self, q: np.ndarray) -> None:
        """Moves the spine to angles (B, H) and the body with it, from where they are."""
        now = self.angles()[0].astype(float)
        rest = self.grid.nodes
        self._put(self.nodes() + self.spine.skin(q, rest) - self.spine.skin(now, rest), q)

    def _put(self, x: np.ndarray, q: np.ndarray) -> None:
        """Nodes (B, N, 3) and spine at rest there; ghosts mirror their nodes."""
        rest, ghost = self.grid.nodes, self.grid.ghost
        own = np.flatnonzero(ghost >= 0)
        x[:, ghost[own]] = rest[ghost[own]] - (x[:, own] - rest[own])
        self.set_nodes(x)
        self._set_q(q)

    def _set_q(self, q: np.ndarray) -> None:
        a = self.arrays
        a["q"].from_numpy(steps.flat(q))
        a["qd"].fill(0)
        a["momentum"].fill(0)
        a["wrench"].fill(0)
        if self.spine:
            steps.pose(self.state, self.soa)

    def apply(self, loads: Loads, damping=0.0, dt=None, contact_rate=0.0, drift_m=None) -> None:
        """Sets the loads of every body from now on; numbers may be (B,), one a body.

        The momentum is damped by `damping` in 1/s and penetration pushed out by `contact_rate` in 1/s; the
        step is `dt` in s, or the largest stable one of each body, in which the indenter moves by `drift_m`
        (B, 3).
        """
        row = self.load
        loads.fill(row)
        row[:, steps.DRIFT : steps.DRIFT + 3] = 0.0 if drift_m is None else drift_m
        row[:, steps.RATE] = contact_rate
        row[:, steps.DT] = self.stable_dt if dt is None else dt
        row[:, steps.KEEP] = np.exp(-np.asarray(damping) * row[:, steps.DT])
        if not np.isfinite(row).all():
            raise InputError(f"Body '{self.body.name}': a load is not a finite number.")
        if (row[:, steps.DT] > 1.01 * self.stable_dt).any():
            raise InputError(
                f"Body '{self.body.name}': a step of {row[:, steps.DT].max():.3g} s is too large for its "
                f"speed of sound ({self.sound_speed.max():.3g} m/s over {self.grid.dx:.3g} m); use at most "
                f"{self.stable_dt.min():.3g} s."
            )
        shapes = loads.shapes(self.batch)
        self.touching, self.taken = bool(shapes.any()), 0
        self.arrays["load"].from_numpy(steps.flat(row))
        self.arrays["shape"].from_numpy(shapes)
        if self.spine:
            q = loads.targets(self.batch, self.hinges)
            if not np.isfinite(q).all():
                raise InputError(f"Body '{self.body.name}': a joint target is not a finite number.")
            gains = (self.spine.stiffness_nm_per_rad, self.spine.damping_nms_per_rad)
            drive = np.stack([q, *(np.full(q.shape, g) for g in gains)], -1)
            self.drive_target = q.astype(np.float32).astype(float)
            self.arrays["drive"].from_numpy(steps.flat(drive))

    def set_table(self, table: np.ndarray) -> None:
        """Sets the signed distances (n, n, n) of the indenter `mesh`, as many as there were."""
        self.arrays["table"].from_numpy(steps.flat(table))

    def pace(self, rate: np.ndarray) -> None:
        """Sets critical damping of motions at `rate` (B,) in rad/s, and contact to settle as fast."""
        self.load[:, steps.RATE] = 2 * rate
        self.load[:, steps.KEEP] = np.exp(-2 * rate * self.load[:, steps.DT])
        self.arrays["load"].from_numpy(steps.flat(self.load))

    def heavy_edges(self, on: bool) -> None:
        """Whether nodes that carry little material get the inertia of more.

        Where only the balance of forces counts this keeps them from rattling; true dynamics want it off.
        """
        least = 0.2 * self.grid.dx**3 if on else 0.0
        self.arrays["inertia"].from_numpy(steps.flat(np.maximum(self.grid.volume, least)))

    def step(self, substeps: int) -> None:
        """Advances by a number of substeps."""
        if not self.soa and len(self.grid.cell_mask) >= LARGE and self.batch < 8:
            for i in range(substeps):
                steps.across(self.taken + i, self.state, self.touching)
        else:
            self.gate.fill(0)
            steps.within(self.taken, substeps, self.blocks, self.gate, self.state, self.soa, self.touching)
        self.taken += substeps

    def measure(self) -> dict[str, np.ndarray]:
        """Per body (B,): `residual`, `scale` (both N), `rate` (rad/s).

        `residual` is the norm of the forces on free nodes, `scale` that of the forces from outside (weight,
        contact, links of the spine), `rate` the frequency of the present motion by Rayleigh's quotient.
        """
        steps.measure(self.state, self.sums, self.soa)
        f2, kinetic, stiffness, outer = self.sums.to_numpy().reshape(self.batch, 4).T.astype(float)
        dt = self.load[:, steps.DT]
        with np.errstate(invalid="ignore", divide="ignore"):
            rate = np.sqrt(np.maximum(stiffness / (dt * kinetic), 0.0))
        return {"residual": np.sqrt(f2), "scale": np.sqrt(outer), "rate": np.nan_to_num(rate)}

    def slowest_rate(self) -> np.ndarray:
        """(B,) rad/s: a guess of the lowest frequency, a shear wave over the furthest way to a fixed node."""
        fixed = self.grid.nodes[(self.role >= 0) | (self.grid.ghost >= 0)]
        free = self.grid.nodes[self.role == -1]
        far = np.ptp(free, axis=0).max()
        if len(fixed):
            far = max(float(cKDTree(fixed).query(free)[0].max()), self.grid.dx)
        shear = np.sqrt([m.lame[0] / m.density_kg_m3 for m in self.materials])
        return 0.5 * np.pi * shear / far

    def least_force(self) -> np.ndarray:
        """(B,) N: forces from outside below this count as none, like those of a strain of 1e-5 everywhere."""
        youngs = np.array([m.youngs_modulus_pa for m in self.materials])
        return 1e-5 * youngs * self.grid.dx**2 * np.sqrt(len(self.grid.cell_mask))

    def energy(self) -> np.ndarray:
        """(B,) kinetic energy of the nodes, J."""
        v = self._unflat(self.arrays["v"].to_numpy()).astype(float)
        rho = self.load[:, steps.RHO]
        return 0.5 * rho * (self.arrays["inertia"].to_numpy()[:, None] * v**2).sum((1, 2))

    def overlap(self) -> np.ndarray:
        """(B,) m: how deep the surface lies in the indenter; 0 where it does not."""
        steps.overlap(self.state, self.soa)
        depth = self.arrays["contact"].to_numpy().reshape(self.batch, -1, 4)[..., 3]
        return np.maximum(depth.max(1, initial=0.0), 0.0)

    def nodes(self) -> np.ndarray:
        """(B, N, 3) m."""
        return self.grid.nodes + self._unflat(self.arrays["u"].to_numpy())

    def particles(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, P, 3) positions in m and (B, P, 3, 3) deformation gradients."""
        count = len(self.body.cells)
        if self._particles is None:
            numbers = (self.grid.particle_cell, self.grid.particle_local, np.zeros((self.batch, count, 12)))
            self._particles = [steps.send(a) for a in numbers]
        steps.particles(count, self.state, self.soa, *self._particles)
        out = self._particles[-1].to_numpy().reshape(self.batch, count, 12)
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
        return steps.flat(np.swapaxes(x, 1, 2) if self.soa else x)

    def _unflat(self, flat):
        b, n = self.batch, len(self.grid.nodes)
        return np.swapaxes(flat.reshape(b, 3, n), 1, 2) if self.soa else flat.reshape(b, n, 3)
