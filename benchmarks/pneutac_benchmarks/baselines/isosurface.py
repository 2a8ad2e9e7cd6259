"""A surface through a field on a lattice, by marching tetrahedra."""

import numpy as np
import trimesh

# Corner k of a cube lies at the bits of k along x, y, z; six tetrahedra about the diagonal from 0 to 7.
TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])


def isosurface(field: np.ndarray, level: float, spacing: float, origin: np.ndarray) -> trimesh.Trimesh:
    """Closed surface where a field equals `level`; normals point to lower values.

    Marching cubes (Lorensen and Cline 1987) on cubes cut into tetrahedra, which have no ambiguous cases.

    Args:
        field: (nx, ny, nz), below `level` at the border.
        level: value on the surface.
        spacing: of the lattice.
        origin: (3,) place of field[0, 0, 0].
    """
    shape = np.array(field.shape)
    cubes = np.stack(np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"), -1).reshape(-1, 3)
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    corners = np.ravel_multi_index((cubes[:, None] + bits).transpose(2, 0, 1), shape)  # (C, 8)
    values = field.ravel()
    above = values > level
    mixed = above[corners].any(1) & ~above[corners].all(1)
    tets = corners[mixed][:, TETRAHEDRA].reshape(-1, 4)
    count = above[tets].sum(1)
    # In every tetrahedron the corners above the level come first.
    tets = np.take_along_axis(tets, np.argsort(~above[tets], axis=1, kind="stable"), 1)
    one, two, three = (tets[count == k] for k in (1, 2, 3))
    triangles = np.concatenate(
        [
            one[:, [[0, 1], [0, 2], [0, 3]]],
            two[:, [[0, 2], [0, 3], [1, 3]]],
            two[:, [[0, 2], [1, 3], [1, 2]]],
            three[:, [[0, 3], [1, 3], [2, 3]]],
        ]
    )  # (T, 3, 2): each vertex lies on an edge, named by its ends
    inner = np.concatenate([one[:, 0], two[:, 0], two[:, 0], three[:, 0]])
    edges, index = np.unique(np.sort(triangles.reshape(-1, 2), 1), axis=0, return_inverse=True)
    low, high = values[edges[:, 0]], values[edges[:, 1]]
    share = ((level - low) / (high - low))[:, None]
    place = np.stack(np.unravel_index(np.arange(values.size), shape), 1).astype(float)
    vertices = (1 - share) * place[edges[:, 0]] + share * place[edges[:, 1]]
    faces = index.reshape(-1, 3)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), place[inner] - a) > 0
    faces[inwards] = faces[inwards][:, ::-1]
    return trimesh.Trimesh(origin + spacing * vertices, faces, process=False)
