"""The soft solid of a finger or an arm: its particles, and what of them each link carries."""

from dataclasses import dataclass
from itertools import product

import numpy as np
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.parameters import parameter
from pneutac_sim.mpm.sections import lattice_inside
from pneutac_sim.mpm.shapes import arm_mesh, finger_mesh
from pneutac_sim.mpm.user_mesh import stored_mesh
from pneutac_sim.twin import Twin

SPACINGS = np.linspace(-0.08, 0.08, 33)  # tried, off the one that volume and number of particles give
GOOD = 0.01  # relative error at which the search ends


def filled_body(name: str, mesh: trimesh.Trimesh, material: Material, particles: int) -> Body:
    """A body held at its least x, on the lattice that errs least in number of particles and in volume.

    Both jump with the spacing, as a section is so many whole particles wide: spacings, and one particle more
    or less across, are tried, the nearest spacing first.

    Args:
        name: shown in errors.
        mesh: closed, outward, m.
        material: neo-Hookean solid.
        particles: about how many.

    Raises:
        InputError: the mesh is open, or no particle lies inside.
    """
    volume = float(mesh.volume) if mesh.is_watertight else 0.0
    if not volume > 0:
        raise InputError(f"Body '{name}': the mesh is open, empty or turned inside out, so it has no inside.")
    triangles = np.ascontiguousarray(mesh.triangles, float)
    low, high = mesh.bounds
    best, least = None, np.inf
    for step in sorted(SPACINGS, key=abs):
        h = (1 + step) * (volume / particles) ** (1 / 3)
        whole = (high - low) / h
        ways = [{round(whole[0])}, *({int(n), int(n) + 1} for n in whole[1:])]
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
        raise InputError(f"Body '{name}': no particle of {particles} lies inside the mesh; ask for more.")
    cells, h, origin = best
    corner = cells.min(0)
    return Body(name, (cells - corner).astype(np.int32), h, origin + corner * h, "x-", material)


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
        """Each particle, a cube of its spacing, goes with its nearest link.

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
