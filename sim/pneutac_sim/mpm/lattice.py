"""The lattice that fills a mesh with about as many particles as were asked for, and as much volume."""

from itertools import product

import numpy as np
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.sections import lattice_inside

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
