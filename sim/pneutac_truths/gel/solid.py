"""A bonded layer of nearly incompressible rubber under a rigid indenter, by finite elements.

Neo-Hookean, W = mu/2 (J^(-2/3) I1 - 3) + kappa/2 (J - 1)^2 (Bonet and Wood, Nonlinear Continuum Mechanics
for Finite Element Analysis (2008) sec. 6.5), on hexahedra whose change of volume is integrated at one point,
which keeps them from locking (Malkus and Hughes, CMAME 15 (1978) 63). Contact is frictionless, by penalty
(Wriggers, Computational Contact Mechanics (2006) ch. 6). The depth grows in steps of Newton's method.

Rigid indenters as signed distances, and how far each mesh must reach for them.

Distances of boxes, prisms and cones: Hart, The Visual Computer 12 (1996) 527. Edges are broken by a small
radius, as machined ones are. All in mm, in the indenter's frame: its lowest point is at the origin, z up.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

BROKEN_EDGE_MM = 0.12
KINDS = ("sphere", "cylinder", "cube", "edge", "cone")


@dataclass(frozen=True)
class Punch:
    """A rigid indenter."""

    # one of `KINDS`; `cylinder` stands on its flat end, `edge` is a cube on an edge along x, `cone` has a
    # right angle at its apex
    kind: str
    size_mm: float = 3.0  # radius of sphere and cylinder, side of cube and edge; unused for a cone
    mirrored: ClassVar = (True, True)  # its own mirror image in x and in y: a quarter of the gel will do

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"There is no indenter '{self.kind}'; it must be one of {', '.join(KINDS)}.")

    def reach_mm(self, depth_mm: float) -> tuple[float, float]:
        """How far it touches along x and y at most."""
        s, d = self.size_mm, depth_mm
        ball = float(np.sqrt(1.2 * s * d))
        of_kind = {"cylinder": (s, s), "cube": (s / 2, s / 2), "edge": (s / 2, d), "cone": (d, d)}
        return of_kind.get(self.kind, (ball, ball))

    def distance(self, p: np.ndarray) -> np.ndarray:
        """Signed distance (n,) of points (n, 3) to its surface; negative inside."""
        x, y, z = p.T
        s, r = self.size_mm, BROKEN_EDGE_MM
        if self.kind == "sphere":
            return np.sqrt(x**2 + y**2 + (z - s) ** 2) - s
        if self.kind == "cylinder":
            return _prism(np.hypot(x, y) - s, z, r)
        if self.kind == "cube":
            return _prism(_corner(np.abs(x) - s / 2, np.abs(y) - s / 2), z, r)
        if self.kind == "edge":
            half = s / 2 - r
            up = z - r - half * np.sqrt(2)  # over the cube's middle
            a, b = (y + up) / np.sqrt(2), (up - y) / np.sqrt(2)
            q = np.stack([np.abs(x) - half, np.abs(a) - half, np.abs(b) - half])
            return np.linalg.norm(np.maximum(q, 0), axis=0) + np.minimum(q.max(0), 0) - r
        rho, up = np.hypot(x, y), z - r
        flank = (rho - up) / np.sqrt(2)
        return np.where(rho + up > 0, flank, np.hypot(rho, up)) - r

    def outward(self, p: np.ndarray) -> np.ndarray:
        """Gradient (n, 3) of the distance, by central differences."""
        h = 1e-5
        steps = h * np.eye(3)
        return np.stack([(self.distance(p + e) - self.distance(p - e)) / (2 * h) for e in steps], 1)


def _corner(u, v):
    return np.hypot(np.maximum(u, 0), np.maximum(v, 0)) + np.minimum(np.maximum(u, v), 0)


def _prism(outside, z, r: float):
    """A prism that stands on z = 0, its lower edge broken by r; `outside` is the distance to its outline."""
    return _corner(outside + r, r - z) - r


STIFF = 100.0  # penalty over mu / element size
LEAST_STEP_MM = 0.01
NEWTON, CLOSE = 30, 1e-3  # steps, and the share of the load's nodal forces that may be left


@dataclass(frozen=True)
class Rubber:
    """The layer."""

    thickness_mm: float = 3.0  # of the layer, bonded below
    mu_kpa: float = 40.0  # shear modulus
    poisson: float = 0.49  # ratio at small strain

    @property
    def kappa_kpa(self) -> float:
        """Bulk modulus."""
        return 2 * self.mu_kpa * (1 + self.poisson) / (3 * (1 - 2 * self.poisson))


@dataclass(frozen=True)
class Face:
    """The pressed face in the indenter's frame."""

    x_mm: np.ndarray  # (n,) where its nodes rest
    y_mm: np.ndarray  # (m,)
    moved_mm: np.ndarray  # (n, m, 3) displacements; z points out of the gel
    touching: np.ndarray  # (n, m) nodes that carry pressure
    force_n: float  # on the indenter

    def at(self, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
        """Displacements (..., 3) of points that rest at x and y, cubic between nodes; 0 beyond the mesh."""
        splines = (RectBivariateSpline(self.x_mm, self.y_mm, self.moved_mm[..., k]) for k in range(3))
        out = np.stack([s.ev(x_mm, y_mm) for s in splines], -1)
        beyond = (np.abs(x_mm) > self.x_mm[-1]) | (np.abs(y_mm) > self.y_mm[-1])
        return np.where(beyond[..., None], 0.0, out)


def press(
    punch: Punch, depth_mm: float, rubber: Rubber, fine_mm: float = 0.25, step_mm: float = 0.25
) -> Face:
    """Presses an indenter in by steps; by half of one where there is no equilibrium.

    `depth_mm` is that of its lowest point below the resting face, `fine_mm` the size of elements near the
    contact. Raises ArithmeticError where no equilibrium was found.
    """
    mesh = Mesh(punch, depth_mm, rubber, fine_mm)
    u = np.zeros(mesh.rest.shape)
    left = list(np.linspace(0, depth_mm, int(np.ceil(depth_mm / step_mm)) + 1)[:0:-1])
    at = 0.0
    while left:
        depth = left[-1]
        try:
            u = mesh.settle(u * (depth / at if at else 1.0), punch, depth)
        except ArithmeticError:
            if depth - at < LEAST_STEP_MM:
                raise
            left.append((at + depth) / 2)
        else:
            at = left.pop()
    return mesh.face(u, punch, depth_mm)


def spaced(touched_mm: float, end_mm: float, fine_mm: float, wider: float) -> np.ndarray:
    """Nodes from 0 to `end_mm`, evenly a little beyond what is touched, then each `wider` times its last."""
    even = touched_mm + 3 * fine_mm
    nodes = list(np.linspace(0, even, int(np.ceil(even / fine_mm)) + 1))
    width = fine_mm
    while nodes[-1] < end_mm:
        width *= wider
        nodes.append(nodes[-1] + width)
    return np.array(nodes)


class Mesh:
    """Hexahedra below one indenter: half or a quarter of the gel where that mirrors the rest."""

    def __init__(self, punch: Punch, depth_mm: float, rubber: Rubber, fine_mm: float):
        from skfem import Basis, ElementHex1, MeshHex

        self.rubber, self.mirrored, t = rubber, punch.mirrored, rubber.thickness_mm
        self.axes = []
        for reach, mirrored in zip(punch.reach_mm(depth_mm), self.mirrored, strict=True):
            half = spaced(reach, reach + 2 * t, fine_mm, 1.3)
            self.axes.append(half if mirrored else np.concatenate([-half[:0:-1], half]))
        down = spaced(0.0, t, fine_mm, 1.1)  # what lies deep decides how stiff a thin layer is
        mesh = MeshHex.init_tensor(*self.axes, np.sort(-down * t / down[-1]))
        self.rest = mesh.p.T.copy()
        full, single = (Basis(mesh, ElementHex1(), intorder=k) for k in (2, 1))
        self.nodes = full.element_dofs.T  # (elements, 8)
        self.grad, self.weight = _gradients(full)
        self.grad_1, self.weight_1 = _gradients(single)
        x, y, z = self.rest.T
        held = np.zeros(self.rest.shape, bool)
        held[z <= z.min() + 1e-9] = True
        for k, mirrored in enumerate(self.mirrored):
            if mirrored:
                held[self.rest[:, k] < 1e-9, k] = True
        self.free = np.flatnonzero(~held.ravel())
        self.top = np.flatnonzero(z > -1e-9)
        self.top = self.top[np.lexsort((y[self.top], x[self.top]))]  # x slowest
        end_halved = (np.where((np.arange(len(a)) % (len(a) - 1)) == 0, 0.5, 1.0) for a in self.axes)
        self.area = np.outer(
            *(np.gradient(a) * w for a, w in zip(self.axes, end_halved, strict=True))
        ).ravel()
        self.penalty = STIFF * rubber.mu_kpa / fine_mm * self.area
        dof = (3 * self.nodes[:, :, None] + np.arange(3)).reshape(len(self.nodes), 24)
        self._rows, self._columns = np.repeat(dof, 24, 1).ravel(), np.tile(dof, 24).ravel()
        self._dof = dof

    def settle(self, u: np.ndarray, punch: Punch, depth_mm: float) -> np.ndarray:
        """Displacements (nodes, 3) in equilibrium at a depth, from near ones."""
        for _ in range(NEWTON):
            energy, force, stiffness = self._state(u, punch, depth_mm)
            if not np.isfinite(energy):
                u = 0.9 * u  # an element is inside out: from nearer to rest
                continue
            left = force[self.free]
            load = np.abs(self._pushed(u, punch, depth_mm)[1]).sum()
            if np.abs(left).sum() < CLOSE * max(load, 1e-9):
                return u
            how = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
            solver = splu(stiffness[self.free][:, self.free], "MMD_AT_PLUS_A", **how)
            way = np.zeros(u.size)
            way[self.free] = -solver.solve(left)
            way, slope, length = way.reshape(u.shape), min(float(way @ force), 0.0), 1.0
            for _ in range(6):
                if self._energy(u + length * way, punch, depth_mm) <= energy + 1e-4 * length * slope:
                    break
                length *= 0.5
            u = u + length * way
        raise ArithmeticError(
            f"The {punch.kind} finds no equilibrium {depth_mm:.3g} mm deep; take smaller steps."
        )

    def face(self, u: np.ndarray, punch: Punch, depth_mm: float) -> Face:
        """What the camera's side sees, mirrored to the whole."""
        n, m = (len(a) for a in self.axes)
        pressure = self._pushed(u, punch, depth_mm)[1]
        moved, touching = u[self.top].reshape(n, m, 3), (pressure[:, 2] != 0).reshape(n, m)
        axes = list(self.axes)
        force = -float(pressure[:, 2].sum()) * 1e-3  # kPa mm^2 are mN
        for k in np.flatnonzero(self.mirrored):
            sign = np.where(np.arange(3) == k, -1.0, 1.0)
            tail = [slice(None)] * 2
            tail[k] = slice(None, 0, -1)
            moved = np.concatenate([moved[tuple(tail)] * sign, moved], k)
            touching = np.concatenate([touching[tuple(tail)], touching], k)
            axes[k] = np.concatenate([-axes[k][:0:-1], axes[k]])
            force *= 2
        return Face(axes[0], axes[1], moved, touching, force)

    # ---------------------------------------------------------------- energy and its derivatives, mN mm

    def _pushed(self, u, punch: Punch, depth_mm: float):
        """Depth inside the indenter (top,) and the nodal forces (top, 3) of what touches, mN."""
        p = self.rest[self.top] + u[self.top] + [0, 0, depth_mm]
        inside = np.maximum(-punch.distance(p), 0.0)
        force = np.zeros((len(p), 3))
        at = np.flatnonzero(inside)
        if at.size:
            force[at] = (self.penalty[at] * inside[at])[:, None] * punch.outward(p[at])
        return inside, force

    def _stretched(self, u, grad):
        return np.eye(3) + np.einsum("eai,eqaj->eqij", u[self.nodes], grad, optimize=True)

    def _energy(self, u, punch: Punch, depth_mm: float) -> float:
        F, J1 = self._stretched(u, self.grad), np.linalg.det(self._stretched(u, self.grad_1))
        J = np.linalg.det(F)
        if J.min() <= 0.02 or J1.min() <= 0.02:
            return np.inf
        iso = 0.5 * self.rubber.mu_kpa * (J ** (-2 / 3) * np.square(F).sum((2, 3)) - 3)
        volume = 0.5 * self.rubber.kappa_kpa * np.square(J1 - 1)
        inside = self._pushed(u, punch, depth_mm)[0]
        contact = 0.5 * (self.penalty * inside**2).sum()
        return float((iso * self.weight).sum() + (volume * self.weight_1).sum() + contact)

    def _state(self, u, punch: Punch, depth_mm: float) -> tuple[float, np.ndarray, csc_matrix]:
        """Energy, its gradient (3 nodes,) and its second derivative."""
        energy = self._energy(u, punch, depth_mm)
        if not np.isfinite(energy):
            return energy, np.zeros(u.size), csc_matrix((u.size, u.size))
        stress = _iso(self._stretched(u, self.grad), self.rubber.mu_kpa)
        f, K = _gathered(*stress, self.grad, self.weight)
        stress = _volume(self._stretched(u, self.grad_1), self.rubber.kappa_kpa)
        f1, K1 = _gathered(*stress, self.grad_1, self.weight_1)
        force = np.bincount(self._dof.ravel(), (f + f1).ravel(), u.size)
        inside, push = self._pushed(u, punch, depth_mm)
        dof = 3 * self.top[:, None] + np.arange(3)
        np.subtract.at(force, dof.ravel(), push.ravel())
        at = np.flatnonzero(inside)
        normal = push[at] / (self.penalty[at] * inside[at])[:, None]
        contact = self.penalty[at, None, None] * normal[:, :, None] * normal[:, None, :]
        values = np.concatenate([(K + K1).ravel(), contact.ravel()])
        rows = np.concatenate([self._rows, np.repeat(dof[at], 3, 1).ravel()])
        columns = np.concatenate([self._columns, np.tile(dof[at], 3).ravel()])
        return energy, force, coo_matrix((values, (rows, columns)), (u.size, u.size)).tocsc()


def _gradients(basis) -> tuple[np.ndarray, np.ndarray]:
    """Of the shape functions (elements, points, 8, 3), and the points' volumes (elements, points)."""
    grad = np.stack([basis.basis[a][0].grad for a in range(8)])  # (8, 3, elements, points)
    grad = np.broadcast_to(grad, (8, 3, *basis.dx.shape)).transpose(2, 3, 0, 1)
    return np.ascontiguousarray(grad), basis.dx


def _iso(F, mu: float):
    """First Piola-Kirchhoff stress (..., 3, 3) and its derivative (..., 9, 9) of what keeps the volume."""
    J, I1 = np.linalg.det(F)[..., None, None], np.square(F).sum((-2, -1))[..., None, None]
    G = np.linalg.inv(F).swapaxes(-1, -2)  # F^-T
    scale = mu * J ** (-2 / 3)
    P = scale * (F - I1 / 3 * G)
    f, g = _flat(F), _flat(G)
    cross = np.einsum("...a,...b->...ab", f, g) + np.einsum("...a,...b->...ab", g, f)
    A = np.eye(9) - 2 / 3 * cross + 2 / 9 * I1 * np.einsum("...a,...b->...ab", g, g) + I1 / 3 * _turned(G)
    return P, scale * A


def _volume(F, kappa: float):
    J = np.linalg.det(F)[..., None, None]
    G = np.linalg.inv(F).swapaxes(-1, -2)
    g = _flat(G)
    A = (2 * J - 1) * J * np.einsum("...a,...b->...ab", g, g) - (J - 1) * J * _turned(G)
    return kappa * (J - 1) * J * G, kappa * A


def _flat(F):
    return F.reshape(*F.shape[:-2], 9)


def _turned(G):
    """(..., 9, 9) of dF -> G dF^T G: element (iJ, kL) is G_iL G_kJ."""
    return np.einsum("...il,...kj->...ijkl", G, G).reshape(*G.shape[:-2], 9, 9)


def _gathered(P, A, grad, weight):
    """Nodal forces (elements, 24) and stiffness (elements, 24, 24)."""
    e, q = weight.shape
    B = np.zeros((e, q, 9, 8, 3))  # dF_iJ = N_a,J u_ai
    for i in range(3):
        B[:, :, 3 * i : 3 * i + 3, :, i] = grad.swapaxes(-1, -2)
    B = B.reshape(e, q, 9, 24)
    force = ((_flat(P) * weight[..., None])[:, :, None, :] @ B).sum((1, 2))
    AB = (A * weight[..., None, None]) @ B
    return force, B.reshape(e, 9 * q, 24).swapaxes(-1, -2) @ AB.reshape(e, 9 * q, 24)
