"""The reference solver: updated-Lagrangian material points (MLS-MPM, APIC) with a spine coupled by CPIC.

It shares the bodies, the loads and the contact law with `TotalLagrangian` and nothing of its discretisation:
particles carry the deformation and the grid stays where it is, so each checks the other. It is slow, uses
float64, and is written to be read beside the paper cited in `kernels`.

Choices where the papers leave one:

- A link is a strip without thickness in the plane z = `Spine.z_m`, `Spine.radius_m` wide to either side. The
  particles above it are of side +1, those below of -1 for good; one that lies on it sticks to it altogether.
- A strip has no mass of its own. Each substep it takes mass, momentum and force of all transfers that cross
  it, the hinges find their rates from these, and what the particles get back has the links' velocity. So a
  joint feels exactly what is taken from the particles, and nothing in it depends on the time step.
- Nodes beyond the clamped side move opposite to those that they mirror.
- An indenter pushes the middle of each outer face of the surface's particles.
"""

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm import state as rows
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.rest_grid import RestGrid
from pneutac_sim.mpm.runtime import start, ti
from pneutac_sim.mpm.spine import Spine
from pneutac_sim.mpm.total_lagrangian import CFL, TotalLagrangian
from updated_lagrangian import kernels as kern
from updated_lagrangian.links import skin_gradient, strips

MARGIN = 3  # cells of the box round the body
STRIDE = 50  # substeps until the box is laid anew


class UpdatedLagrangian:
    """A batch of bodies of one shape; arguments and methods as those of `TotalLagrangian`."""

    # Loads, and what is read from them, lie in the same rows for both solvers.
    apply = TotalLagrangian.apply
    pace = TotalLagrangian.pace
    angles = TotalLagrangian.angles
    contact = TotalLagrangian.contact
    slowest_rate = TotalLagrangian.slowest_rate
    least_force = TotalLagrangian.least_force

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
        self.grid = RestGrid.of(body)  # at rest: for its spacing and what the spine holds
        self.rest = body.positions
        self.hinges = h = spine.hinges if spine else 0
        self.role = np.where(self.grid.mirrored, -2, -1)
        if spine:
            link = spine.bind(body, self.grid)
            self.role[link >= 0] = link[link >= 0]
        b, p = batch, len(self.rest)
        mu, lam = np.array([m.lame for m in self.materials]).T
        self.sound_speed = np.array([m.sound_speed for m in self.materials])
        self.stable_dt = CFL * self.grid.dx / self.sound_speed
        self.load = np.zeros((b, rows.LOAD), np.float32)
        self.load[:, rows.MU], self.load[:, rows.LAM] = mu, lam
        self.load[:, rows.RHO] = [m.density_kg_m3 for m in self.materials]
        self.load[:, rows.DT] = self.stable_dt
        self.load[:, rows.SPRING] = 0.25 * (lam + 2 * mu) * self.grid.dx
        self.owner, normal, first = _faces(body)
        side = np.sign(np.round((self.rest[:, 2] - spine.z_m) / body.spacing_m, 3)) if spine else np.zeros(p)
        table = np.zeros((2, 2, 2)) if table is None else table
        self.samples, s = len(table), len(normal)
        f4, i4 = np.float32, np.int32
        self.arrays = {
            name: _send(np.asarray(a))
            for name, a in {
                "load": self.load, "side": side.astype(i4), "start": first.astype(i4),
                "shape": np.zeros(b, i4), "table": table.astype(f4), "anchor": np.zeros((b, s, 5), f4),
                "contact": np.zeros((b, s, 4), f4), "q": np.zeros(b * h), "qd": np.zeros(b * h),
                "drive": np.zeros((b, h, 3), f4), "chain": spine.chain if spine else np.zeros(6),
                "strip": strips(spine) if spine else np.zeros(5), "pose": np.zeros((b, h + 1, 12)),
                "M": np.zeros((b, h, h)), "soft": np.zeros((b, h)), "momentum": np.zeros((b, h)),
            }.items()
        }  # fmt: skip
        self.arrays |= {"x": _vectors(b * p), "v": _vectors(b * p), "normal": _vectors(s)}
        self.arrays |= {name: ti.Matrix.ndarray(3, 3, ti.f64, shape=(b * p,)) for name in "CF"}
        self.arrays["normal"].from_numpy(normal)
        self.nodes, self.low, self.size = 0, np.zeros(3, int), np.zeros(3, int)
        self.touching = False
        self.reset()

    def reset(self) -> None:
        """Every body at rest, straight, untouched."""
        self.arrays["anchor"].fill(0)
        self.arrays["contact"].fill(0)
        self._put(self.rest, np.eye(3))
        self._set_q(np.zeros((self.batch, self.hinges)))

    def set_q(self, q: np.ndarray) -> None:
        """Puts the spine at angles (B, H) in rad, at rest, and carries the body along smoothly."""
        q = np.broadcast_to(np.asarray(q, float), (self.batch, self.hinges))
        self._put(self.spine.skin(q, self.rest), skin_gradient(self.spine, q, self.rest))
        self._set_q(q)

    def shift_q(self, q: np.ndarray) -> None:
        """Moves the spine to angles (B, H) and the body with it, from where they are."""
        now = self.angles()[0].astype(float)
        x, F = self.particles()
        x = x + self.spine.skin(q, self.rest) - self.spine.skin(now, self.rest)
        after, before = (skin_gradient(self.spine, a, self.rest) for a in (q, now))
        self._put(x, after @ np.linalg.inv(before) @ F)
        self._set_q(q)

    def _put(self, x: np.ndarray, F: np.ndarray) -> None:
        a, shape = self.arrays, (self.batch, len(self.rest))
        a["x"].from_numpy(np.broadcast_to(x, (*shape, 3)).reshape(-1, 3).copy())
        a["F"].from_numpy(np.broadcast_to(F, (*shape, 3, 3)).reshape(-1, 3, 3).copy())
        a["v"].fill(0)
        a["C"].fill(0)

    def _set_q(self, q: np.ndarray) -> None:
        if self.spine:
            a = self.arrays
            a["q"].from_numpy(q.ravel().copy())
            a["qd"].fill(0)
            poses = self.spine.poses(q)
            flat = np.concatenate([poses[..., :3].reshape(*poses.shape[:-2], 9), poses[..., 3]], -1)
            a["pose"].from_numpy(flat.ravel())

    def heavy_edges(self, on: bool) -> None:
        """Nothing: APIC's own damping quiets nodes that carry little material."""

    def step(self, substeps: int) -> None:
        """Goes on by a number of substeps."""
        for done in range(0, substeps, STRIDE):
            self._lay_box()
            self._go(min(STRIDE, substeps - done), done)

    def _lay_box(self) -> None:
        """Lays the box of nodes round all bodies."""
        x = self.arrays["x"].to_numpy()
        if not np.isfinite(x).all():
            return  # it has diverged, which `measure` and `energy` show
        cells = np.floor((x - self.body.origin_m) / self.grid.dx).astype(int)
        low, high = cells.min(0), cells.max(0) + 3
        if (low > self.low).all() and (high < self.low + self.size).all():
            return
        self.low, self.size = low - MARGIN, high - low + 2 * MARGIN
        nodes = int(self.size.prod())
        if nodes > self.nodes:
            n = self.batch * nodes
            self.arrays |= {"m": ti.ndarray(ti.f64, (2 * n,)), "tag": ti.ndarray(ti.i32, (n,))}
            self.arrays |= {"u": _vectors(2 * n), "f": _vectors(2 * n)}
            self.nodes = nodes
        self.arrays["tag"].fill(0)

    def _go(self, substeps: int, done: int = 0) -> None:
        clamp = "xyz".index(self.body.clamp[0]) if self.body.clamp else -1
        counts = (
            self.batch,
            len(self.rest),
            int(self.size.prod()),
            len(self.owner),
            self.hinges,
            self.samples,
        )
        places = (ti.Vector(a.tolist()) for a in (self.body.origin_m, self.low, self.size))
        fixed = (
            self.grid.dx,
            *places,
            self.device == "cpu",
            self.touching,
            *(self.arrays[k] for k in _ORDER),
        )
        for taken in range(done, done + substeps):
            kern.substep(*counts, clamp, taken, *fixed)

    def measure(self) -> dict[str, np.ndarray]:
        """Takes one substep and tells, a body (B,): `residual`, `scale` (both N), `rate` (rad/s).

        As for `TotalLagrangian`, but for `scale` the stress in a cell of eight particles is taken to be the
        same everywhere: the factor is then the sum of squares of the slopes of its 27 nodes.
        """
        before = self._layer("f")
        self._go(1)
        f, u, m = self._layer("f"), self._layer("u"), self._layer("m")
        f2 = np.where(m[..., None] > 0, f**2, 0).sum((1, 2))
        with np.errstate(invalid="ignore", divide="ignore"):
            stiffness = -(np.where(m[..., None] > 0, u * (f - before), 0)).sum((1, 2))
            kinetic = (m[..., None] * u**2).sum((1, 2))
            rate = np.sqrt(np.maximum(stiffness / (self.load[:, rows.DT] * kinetic), 0.0))
            F = self.particles()[1]
            inverse = np.linalg.inv(F).swapaxes(-1, -2)
            mu, lam = self.load[:, [rows.MU, rows.LAM]].T[..., None, None, None]
            P = mu * (F - inverse) + lam * np.log(np.linalg.det(F))[..., None, None] * inverse
        inner = 1.09 * ((self.grid.dx**2 / 8) ** 2 * (P @ F.swapaxes(-1, -2)) ** 2).sum((1, 2, 3))
        return {"residual": np.sqrt(f2), "scale": np.sqrt(inner), "rate": np.nan_to_num(rate)}

    def _layer(self, name: str) -> np.ndarray:
        """(B, N, ...) of the nodes' free layer."""
        a = self.arrays[name].to_numpy()[: 2 * self.batch * int(self.size.prod())]
        return a.reshape(self.batch, -1, 2, *a.shape[1:])[:, :, 0]

    def energy(self) -> np.ndarray:
        """(B,) kinetic energy of the particles, J."""
        v = self.arrays["v"].to_numpy().reshape(self.batch, -1)
        return 0.5 * self.load[:, rows.RHO] * self.body.spacing_m**3 * (v**2).sum(1)

    def overlap(self) -> np.ndarray:
        """(B,) m: how deep the surface lies in the indenter; 0 where it does not."""
        names = ("load", "x", "F", "start", "normal", "shape", "table", "contact")
        counts = (self.batch, len(self.rest), len(self.owner), self.samples, self.grid.dx)
        kern.depths(*counts, *(self.arrays[k] for k in names))
        depth = self.arrays["contact"].to_numpy().reshape(self.batch, -1, 4)[..., 3]
        return np.maximum(depth.max(1, initial=0.0), 0.0)

    def particles(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, P, 3) positions in m and (B, P, 3, 3) deformation gradients."""
        x, F = self.arrays["x"].to_numpy(), self.arrays["F"].to_numpy()
        return x.reshape(self.batch, -1, 3), F.reshape(self.batch, -1, 3, 3)


def _faces(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(S,) particle and (S, 3) outward normal of the surface's faces, by particle; (P + 1,) first of each."""
    taken = {tuple(c) for c in body.cells}
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    bare = np.array([[tuple(c + n) not in taken for n in normals.astype(int)] for c in body.cells])
    if body.clamp:
        axis = "xyz".index(body.clamp[0])
        bare[body.cells[:, axis] == 0, 3 + axis] = False
    owner, which = np.nonzero(bare)
    return owner, normals[which], np.searchsorted(owner, np.arange(len(body.cells) + 1))


def _vectors(n: int):
    return ti.Vector.ndarray(3, ti.f64, shape=(n,))


def _send(a: np.ndarray):
    flat = np.ascontiguousarray(a).ravel() if a.size else np.zeros(1, a.dtype)
    out = ti.ndarray(dtype={"f": ti.f32, "d": ti.f64, "i": ti.i32}[flat.dtype.char], shape=flat.shape)
    out.from_numpy(flat)
    return out


_ORDER = (
    "load x v C F side m u f tag start normal shape table anchor contact q qd drive chain strip pose "
    "M soft momentum"
).split()
