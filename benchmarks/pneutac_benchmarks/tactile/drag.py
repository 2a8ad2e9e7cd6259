"""A punch that is dragged along the gel that it was pressed into, by the finite elements of `solid`.

Coulomb friction at the nodes that touch: a node sticks to where it first touched by a spring as stiff as the
penalty of contact and slides where that pulls harder than the coefficient times its normal force (Wriggers,
Computational Contact Mechanics (2006) sec. 5.2). The normal force is that of the step before, so that
each step has an energy to make least.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix

from pneutac_truths.gel.solid import Face, Mesh, Punch, Rubber

STEP_MM = 0.1  # by which the punch goes on


@dataclass(frozen=True)
class Dragged:
    """A punch `by_mm` farther along x than where the mesh has its middle; as `punches.Punch`."""

    punch: Punch
    by_mm: float
    most_mm: float

    @property
    def kind(self) -> str:
        """Of the punch."""
        return self.punch.kind

    @property
    def mirrored(self) -> tuple[bool, bool]:
        return False, self.punch.mirrored[1]

    def reach_mm(self, depth_mm: float) -> tuple[float, float]:
        x, y = self.punch.reach_mm(depth_mm)
        return x + self.most_mm, y

    def distance(self, p: np.ndarray) -> np.ndarray:
        """Of points (n, 3)."""
        return self.punch.distance(p - [self.by_mm, 0, 0])

    def outward(self, p: np.ndarray) -> np.ndarray:
        """Gradient (n, 3)."""
        return self.punch.outward(p - [self.by_mm, 0, 0])


def drag(
    punch: Punch,
    depth_mm: float,
    drags_mm: list[float],
    rubber: Rubber,
    friction: float,
    fine_mm: float = 0.25,
) -> list[Face]:
    """Presses an indenter in, then moves it along x at this depth.

    Args:
        punch: what presses.
        depth_mm: of its lowest point below the resting face.
        drags_mm: how far, rising from 0; a face is returned for each, in the frame of the first.
        rubber: what is pressed.
        friction: coefficient of Coulomb's law.
        fine_mm: size of the elements under and near the contact.

    Raises:
        ArithmeticError: no equilibrium was found.
    """
    most = drags_mm[-1]
    mesh = _Sticking(Dragged(punch, 0.0, most), depth_mm, rubber, fine_mm)
    u = np.zeros(mesh.rest.shape)
    depths = np.linspace(0, depth_mm, int(np.ceil(depth_mm / 0.15)) + 1)[1:]
    for before, depth in zip([0, *depths[:-1]], depths, strict=True):
        u = mesh.settle(u * (depth / before if before else 1.0), Dragged(punch, 0.0, most), depth)
    faces, at = [], 0.0
    for target in drags_mm:
        steps = int(np.ceil((target - at) / STEP_MM))
        for by in np.linspace(at, target, steps + 1)[1:]:
            here, there = Dragged(punch, at, most), Dragged(punch, float(by), most)
            mesh.hold(u, here, depth_mm, friction)
            u = mesh.settle(u, there, depth_mm)
            at = float(by)
        faces.append(mesh.face(u, Dragged(punch, at, most), depth_mm))
    return faces


class _Sticking(Mesh):
    """A mesh whose face sticks to the punch."""

    def __init__(self, *args):
        super().__init__(*args)
        self._anchor = np.full((len(self.top), 2), np.nan)  # relative to the punch
        self._cap = np.zeros(len(self.top))

    def hold(self, u, punch: Dragged, depth_mm: float, friction: float) -> None:
        """Takes friction from a state of equilibrium: who sticks to what, and how much it bears."""
        place = u[self.top, :2] - [punch.by_mm, 0]
        normal = np.linalg.norm(self._pushed(u, punch, depth_mm)[1], axis=1)
        slid = place - self._anchor
        far, least = np.linalg.norm(slid, axis=1), self._cap / self.penalty
        sliding = far > least  # never of NaN
        self._anchor[sliding] += (slid * (1 - least / np.maximum(far, 1e-12))[:, None])[sliding]
        new = np.isnan(self._anchor[:, 0]) & (normal > 0)
        self._anchor[new] = place[new]
        self._anchor[normal == 0] = np.nan
        self._cap = friction * normal

    def _slip(self, u, punch):
        slid = u[self.top, :2] - [punch.by_mm, 0] - self._anchor
        at = np.flatnonzero((self._cap > 0) & ~np.isnan(slid[:, 0]))
        return at, slid[at], np.linalg.norm(slid[at], axis=1)

    def _energy(self, u, punch, depth_mm: float) -> float:
        at, _, far = self._slip(u, punch)
        k, cap = self.penalty[at], self._cap[at]
        sticks = np.where(k * far < cap, 0.5 * k * far**2, cap * far - 0.5 * cap**2 / k)
        return super()._energy(u, punch, depth_mm) + float(sticks.sum())

    def _state(self, u, punch, depth_mm: float):
        energy, force, stiffness = super()._state(u, punch, depth_mm)
        if not np.isfinite(energy):
            return energy, force, stiffness
        at, slid, far = self._slip(u, punch)
        k, cap = self.penalty[at], self._cap[at]
        pull = np.minimum(k, cap / np.maximum(far, 1e-12))
        dof = 3 * self.top[at][:, None] + np.arange(2)
        np.add.at(force, dof.ravel(), (pull[:, None] * slid).ravel())
        way = slid / np.maximum(far, 1e-12)[:, None]
        across = (
            np.eye(2) - np.where(k * far < cap, 0.0, 1.0)[:, None, None] * way[:, :, None] * way[:, None, :]
        )
        values = pull[:, None, None] * across
        rows, columns = np.repeat(dof, 2, 1).ravel(), np.tile(dof, 2).ravel()
        return (
            energy,
            force,
            stiffness + coo_matrix((values.ravel(), (rows, columns)), stiffness.shape).tocsc(),
        )
