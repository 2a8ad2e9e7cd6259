"""A user's mesh of a finger or an arm: read, repaired, placed and stored in the twin.

body = read_mesh("finger.stl")   # mm, x along the device from its base, neutral axis at y = z = 0
store_mesh(twin, body.mesh)      # travels with the twin's arrays

Measures of a closed mesh: the neutral axis, and which points lie inside.

A bend leaves the neutral axis as long as it was. In a bar of one material it goes through the area centroids
of the cross-sections (beam theory), so that is where a spine lies.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numba import njit

from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.gel.indenter import load_mesh
from pneutac_sim.twin import Twin

STATIONS = 64  # sections, evenly spread


def neutral_axis(mesh: trimesh.Trimesh) -> tuple[np.ndarray, ...]:
    """Area centroids of cross-sections of a closed mesh along x.

    By Green's theorem over each section's outline. Returns x (S,), centroids in y and z (S, 2) and areas
    (S,), in the mesh's unit.
    """
    low, high = mesh.bounds[:, 0]
    # A little off the round numbers at which a mesh has its vertices.
    places = low + (high - low) * (np.arange(STATIONS) + 0.5137) / STATIONS
    x, centres, areas = [], [], []
    for place in places:
        lines, faces = trimesh.intersections.mesh_plane(mesh, (1, 0, 0), (place, 0, 0), return_faces=True)
        if not len(lines):
            continue
        a, b = lines[:, 0, 1:], lines[:, 1, 1:]
        normal = mesh.face_normals[faces][:, 1:]
        # The outline runs so that the material lies to its left.
        turned = (b - a)[:, 1] * normal[:, 0] - (b - a)[:, 0] * normal[:, 1] < 0
        a, b = np.where(turned[:, None], b, a), np.where(turned[:, None], a, b)
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        area = cross.sum() / 2
        if area > 0:
            x.append(place)
            areas.append(area)
            centres.append(((a + b) * cross[:, None]).sum(0) / (6 * area))
    return np.array(x), np.array(centres).reshape(-1, 2), np.array(areas)


def is_inside(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Which points (P, 3) lie inside a closed surface of triangles (F, 3, 3), (P,) bool.

    By its solid angle (Van Oosterom and Strackee 1983).
    """
    out = []
    for point in points:
        a, b, c = np.moveaxis(triangles - point, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        above = np.einsum("ij,ij->i", a, np.cross(b, c))
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        out.append(abs(np.arctan2(above, below).sum()) > np.pi)  # half the angle: 2 pi inside, 0 outside
    return np.array(out)


def lattice_inside(triangles: np.ndarray, origin: np.ndarray, counts: np.ndarray, h: float) -> np.ndarray:
    """Which points of a lattice lie inside a closed mesh of triangles (F, 3, 3) in m, bool of shape `counts`.

    Point (i, j, k) lies at origin + (i + 1/2, j + 1/2, k + 1/2) h. It is inside where the line through it
    along z crosses the surface an odd number of times below it.
    """
    # Lines slightly off the lattice's own meet no vertex or edge of a mesh with round numbers.
    start = origin + 0.5 * h + np.array([1.7e-5, 2.3e-5, 0.0]) * h
    crossings = np.zeros((counts[0], counts[1], counts[2] + 1), np.int32)
    _cross((triangles - start) / h, crossings)
    return np.cumsum(crossings, 2)[..., :-1] % 2 == 1


def lattice_of(mesh: trimesh.Trimesh, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Corner (3,) and points (3,) of the lattice of a spacing that covers a mesh, see `lattice_inside`."""
    low, high = mesh.bounds
    counts = np.maximum(np.round((high - low) / h).astype(int), 1)
    return (low + high) / 2 - counts * h / 2, counts


@njit(cache=True)
def _cross(triangles, crossings):
    nx, ny, nz = crossings.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0:
            continue
        x0 = max(int(np.ceil(min(a[0], b[0], c[0]))), 0)
        x1 = min(int(np.floor(max(a[0], b[0], c[0]))), nx - 1)
        y0 = max(int(np.ceil(min(a[1], b[1], c[1]))), 0)
        y1 = min(int(np.floor(max(a[1], b[1], c[1]))), ny - 1)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
                v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
                if u >= 0 and v >= 0 and u + v <= 1:
                    z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                    crossings[x, y, min(max(int(np.ceil(z)), 0), nz - 1)] += 1


UNITS = {"mm": 1.0, "m": 1000.0}  # in mm
AXES = ("x", "y", "z")
SHORTEST_MM, LONGEST_MM = 5.0, 2000.0  # of a soft finger or arm
UNUSUAL_MM = 400.0  # the length from which on the unit is doubted
MAIN_SHARE = 0.95  # of all volume, from which on the rest is scraps
USUAL_PARTICLES = 4000
CROOKED = 0.1  # of the height, how far the neutral axis may leave a straight line unmentioned
VERTICES, FACES = "mesh_vertices_mm", "mesh_faces"


@dataclass(frozen=True)
class UserMesh:
    """A closed mesh in the base frame."""

    mesh: trimesh.Trimesh  # mm, from x = 0, its neutral axis at y = z = 0
    notes: tuple[str, ...]  # what was repaired or should be known, a sentence each
    shift_mm: np.ndarray  # (3,) by which it was moved once its axes had been renamed

    @property
    def length_mm(self) -> float:
        return round(float(self.mesh.bounds[1, 0]), 4)


def read_mesh(file: str | Path, unit: str = "mm", axis: str | None = None) -> UserMesh:
    """Reads a mesh (STL, OBJ, PLY) with coordinates in mm or m, repairs it and places it.

    It lies along `axis`, x, y or z, in the file, base first; None for the longest side. Axes are renamed in
    cyclic order: with z it bends towards the file's y, with y towards x, with x towards z.

    Raises InputError: not a mesh, no closed body, several bodies, an implausible size, or a hollow one.
    """
    check_choice("unit", unit, UNITS)
    check_choice("axis", axis or AXES[0], AXES)
    mesh = load_mesh(Path(file))
    mesh.apply_scale(UNITS[unit])
    _check_size(mesh, file, unit)
    notes = _close(mesh, file)
    mesh = _one_body(mesh, file, notes)
    shift = _place(mesh, file, axis, notes)
    if mesh.extents[0] > UNUSUAL_MM:
        notes.append(
            f"It is {mesh.extents[0]:.4g} mm long, unusually long for a finger or an arm: check its unit."
        )
    return UserMesh(mesh, tuple(notes), shift)


def store_mesh(twin: Twin, mesh: trimesh.Trimesh) -> None:
    """Puts a placed mesh in mm into the twin's arrays."""
    twin.arrays[VERTICES] = np.asarray(mesh.vertices, np.float32)
    twin.arrays[FACES] = np.asarray(mesh.faces, np.int32)


def stored_mesh(twin: Twin) -> trimesh.Trimesh | None:
    """The twin's own mesh in m, or None where it is parametric.

    Raises InputError: one array without the other, or of a wrong shape.
    """
    if VERTICES not in twin.arrays and FACES not in twin.arrays:
        return None
    vertices, faces = (np.asarray(twin.arrays.get(name, [])) for name in (VERTICES, FACES))
    shaped = all(a.ndim == 2 and a.shape[1] == 3 and len(a) for a in (vertices, faces))
    if not shaped or not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            f"The twin's arrays '{VERTICES}' (V, 3) and '{FACES}' (F, 3) hold no mesh; restore them, or make "
            "the twin again with `pneutac new --mesh=FILE`."
        )
    return trimesh.Trimesh(1e-3 * vertices.astype(float), faces, process=False)


# ---------------------------------------------------------------- reading


def _check_size(mesh: trimesh.Trimesh, file, unit: str) -> None:
    longest = float(mesh.extents.max())
    if longest == 0:
        raise InputError(f"{file} is empty: all its vertices are in one place.")
    if SHORTEST_MM <= longest <= LONGEST_MM:
        return
    drawn = longest / UNITS[unit]
    ways = [
        ("metres", 1000.0, "give the unit m"),
        ("millimetres", 1.0, "give the unit mm"),
        ("inches", 25.4, f"scale it by {25.4 / UNITS[unit]:g}"),
    ]
    likely = [f"if it is in {u}, {how}" for u, mm, how in ways if SHORTEST_MM <= mm * drawn <= LONGEST_MM]
    raise InputError(
        f"{file} read in {unit} is {longest:.4g} mm long, but only lengths of {SHORTEST_MM:g} to "
        f"{LONGEST_MM:g} mm are taken: {', or '.join(likely) or 'scale it'}."
    )


def _close(mesh: trimesh.Trimesh, file) -> list[str]:
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    notes = []
    if len(mesh.faces) and not mesh.is_watertight:
        before = len(mesh.faces)
        trimesh.repair.fill_holes(mesh, use_fan=True)
        notes.append(f"Holes were closed with {len(mesh.faces) - before} triangles: look at geometry.stl.")
    if not len(mesh.faces) or not mesh.is_watertight:
        edges = np.bincount(np.unique(mesh.edges_sorted, axis=0, return_inverse=True)[1].ravel())
        raise InputError(
            f"{file} is not closed: {(edges != 2).sum()} edges do not join exactly two triangles, also after "
            "filling its holes; repair it where it was drawn."
        )
    return notes


def _one_body(mesh: trimesh.Trimesh, file, notes: list[str]) -> trimesh.Trimesh:
    """The one outer body, its normals outward; chambers inside it are filled."""
    parts = [_outward(part) for part in mesh.split(only_watertight=False)]
    parts.sort(key=lambda turned: -turned[0].volume)
    main, turned = parts[0]
    parts = [part for part, _ in parts]
    if not main.volume > 1e-6 * main.extents.max() ** 3:
        raise InputError(f"{file} is flat: it encloses no volume.")
    some = [part.vertices[:: max(1, len(part.vertices) // 20)] for part in parts[1:]]
    outer = [p for p, x in zip(parts[1:], some, strict=True) if not is_inside(x, main.triangles).all()]
    share = main.volume / (main.volume + sum(part.volume for part in outer))
    if share <= MAIN_SHARE:
        raise InputError(
            f"{file} holds {1 + len(outer)} separate bodies, the largest with {share:.0%} of the volume; "
            "join them, or export the soft body alone."
        )
    if turned:
        notes.append(f"Turned {turned} of {len(main.faces)} triangles, whose normals pointed inward.")
    if outer:
        notes.append(f"Left out {len(outer)} small separate bodies, {1 - share:.1%} of the volume.")
    if chambers := len(parts) - 1 - len(outer):
        notes.append(f"Filled {chambers} closed chamber(s): the spine stands for what is in them.")
    return main


def _outward(part: trimesh.Trimesh) -> tuple[trimesh.Trimesh, int]:
    """A closed part with its normals outward, and how many triangles had to be turned for it."""
    before = part.triangles_cross
    trimesh.repair.fix_winding(part)
    inward = trimesh.triangles.mass_properties(part.triangles, skip_inertia=True).volume < 0
    # A new mesh: one that is turned in place may keep the normals that it had cached.
    part = trimesh.Trimesh(part.vertices, part.faces[:, ::-1] if inward else part.faces, process=False)
    return part, int((np.einsum("ij,ij->i", before, part.triangles_cross) < 0).sum())


def _place(mesh: trimesh.Trimesh, file, axis: str | None, notes: list[str]) -> np.ndarray:
    """Turns the long axis to x by the cyclic order of axes, base to x = 0, neutral axis to y = z = 0.

    Returns:
        (3,) shift in mm after the turn.
    """
    if axis is None:
        extents = mesh.extents
        order = np.argsort(-extents)
        if extents[order[1]] > 0.95 * extents[order[0]]:
            raise InputError(
                f"{file} is about as long along {AXES[order[0]]} as along {AXES[order[1]]}; name the axis "
                f"of its length: x, y or z."
            )
        axis = AXES[order[0]]
    turn = AXES.index(axis)
    mesh.vertices = np.roll(mesh.vertices, -turn, axis=1)
    if turn:
        notes.append(f"The file's {axis} became x, its {AXES[turn - 1]} z, towards which pressure bends.")
    x, centres, areas = neutral_axis(mesh)
    middle = np.average(centres, axis=0, weights=areas)
    start = mesh.bounds[0, 0]
    shift = np.array([-start, *-middle])
    mesh.apply_translation(shift)
    away = np.linalg.norm(centres - middle, axis=1)
    inner = np.abs(x - start - mesh.extents[0] / 2) < 0.45 * mesh.extents[0]
    height = float(mesh.extents[2])
    if away[inner].max() > CROOKED * height:
        notes.append(
            f"The neutral axis leaves a straight line by {away[inner].max():.3g} mm (height {height:.3g} "
            "mm), but the spine is straight: expect a bend that is off there."
        )
    if _solid_at_axis(mesh) < 0.8:
        raise InputError(
            f"{file} has no material along its neutral axis, where the spine lies; close the openings of its "
            "chamber, so that it is filled, or export it solid."
        )
    return shift


def _solid_at_axis(mesh: trimesh.Trimesh) -> float:
    """Share of the length where a usual lattice has a particle so near the axis that a spine can hold it."""
    h = (mesh.volume / USUAL_PARTICLES) ** (1 / 3)
    origin, counts = lattice_of(mesh, h)
    y, z = (origin[k] + (np.arange(counts[k]) + 0.5) * h for k in (1, 2))
    near = np.hypot(y[:, None], z) <= 1.5 * h
    return float((lattice_inside(mesh.triangles, origin, counts, h) & near).any((1, 2)).mean())
