"""The soft solid of a finger or an arm: its particles, and what of them each link carries."""

from dataclasses import dataclass

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.lattice import filled_body
from pneutac_sim.mpm.parameters import parameter
from pneutac_sim.mpm.shapes import arm_mesh, finger_mesh
from pneutac_sim.mpm.user_mesh import stored_mesh
from pneutac_sim.twin import Twin

SHAPES = {"finger": finger_mesh, "arm": arm_mesh}


def bending_body(twin: Twin, particles: int = 4000, mesh=None) -> Body:
    """The straight particles of a finger or an arm; `particles` and `mesh` as in `devices.finger`.

    Raises:
        InputError: an impossible mesh or parameter.
    """
    kind, length = twin.device, 1e-3 * twin.length_mm
    material = Material(
        1e6 * parameter(twin, "youngs_modulus_mpa"),
        parameter(twin, "poissons_ratio"),
        parameter(twin, "density_kg_m3"),
    )
    own = stored_mesh(twin) if mesh is None else None
    if own is not None:
        return filled_body(kind, own, material, particles)
    if mesh is None:
        mesh = SHAPES[kind](length, 1e-3 * parameter(twin, "width_mm"))
    return Body.from_mesh(kind, mesh, material, particles=particles, clamp="x-")


@dataclass(frozen=True)
class Links:
    """What each of N + 1 links of a spine carries; link 0 is held at the base.

    Attributes:
        mass_kg: (N + 1,).
        centre_m: (N + 1, 3) of mass, straight finger, m.
        inertia_kg_m2: (N + 1, 3, 3) about it.
    """

    mass_kg: np.ndarray
    centre_m: np.ndarray
    inertia_kg_m2: np.ndarray

    @classmethod
    def of(cls, body: Body, joints_m) -> "Links":
        """Each particle, a cube of its spacing, goes with the link that it lies beside.

        Args:
            body: straight, along x.
            joints_m: (N,) places of the joints along x, ascending, m.

        Raises:
            InputError: a link that moves carries no particle.
        """
        link = np.searchsorted(np.asarray(joints_m, float), body.positions[:, 0])
        particle = body.material.density_kg_m3 * body.spacing_m**3
        n = len(joints_m) + 1
        mass, centre, inertia = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
        for k in range(n):
            own = body.positions[link == k]
            if not len(own):
                if k == 0:
                    continue
                raise InputError(
                    f"Body '{body.name}' has no particle beyond spine joint {k}; use more particles."
                )
            mass[k], centre[k] = particle * len(own), own.mean(0)
            r = own - centre[k]
            spread = r.T @ r + len(own) * body.spacing_m**2 / 12 * np.eye(3)
            inertia[k] = particle * (np.trace(spread) * np.eye(3) - spread)
        return cls(mass, centre, inertia)
