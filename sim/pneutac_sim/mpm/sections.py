"""Measures of a closed mesh: the neutral axis, and which points lie inside.

A bend leaves the neutral axis as long as it was. In a bar of one material it goes through the area centroids
of the cross-sections (beam theory), so that is where a spine lies.
"""

import numpy as np
import trimesh
from numba import njit

STATIONS = 64  # sections, evenly spread


def neutral_axis(mesh: trimesh.Trimesh) -> tuple[np.ndarray, ...]:
    """Area centroids of cross-sections, by Green's theorem over each section's outline.

    Args:
        mesh: closed, its normals outward, x along the device.

    Returns:
        x (S,), centroids in y and z (S, 2) and areas (S,), in the mesh's unit.
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
    """Which points lie inside a closed surface, by its solid angle (Van Oosterom and Strackee 1983).

    Args:
        points: (P, 3).
        triangles: (F, 3, 3) of the surface.

    Returns:
        (P,) bool.
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
    """Which points of a lattice lie inside a closed mesh.

    A point is inside where the line through it along z crosses the surface an odd number of times below it.

    Args:
        triangles: (F, 3, 3) m.
        origin: (3,) m; point (i, j, k) lies at origin + (i + 1/2, j + 1/2, k + 1/2) h.
        counts: (3,) points along x, y, z.
        h: spacing, m.

    Returns:
        (nx, ny, nz) bool.
    """
    # Lines slightly off the lattice's own meet no vertex or edge of a mesh with round numbers.
    start = origin + 0.5 * h + np.array([1.7e-5, 2.3e-5, 0.0]) * h
    crossings = np.zeros((counts[0], counts[1], counts[2] + 1), np.int32)
    _cross((triangles - start) / h, crossings)
    return np.cumsum(crossings, 2)[..., :-1] % 2 == 1


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
