"""Reads triangles from a file."""

from pathlib import Path

import numpy as np
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer

FORMATS = (".stl", ".obj", ".ply")
MOST_BYTES = 200 * 2**20
MOST_FACES = 200_000  # finer than particles resolve, and a twin should stay small


def load_mesh(file: Path) -> trimesh.Trimesh:
    """The triangles of an STL, OBJ or PLY file, as they are.

    Raises InputError where there is none, it is no mesh, or larger than anyone needs.
    """
    if not file.is_file():
        raise InputError(f"There is no mesh '{file}'; give an STL, OBJ or PLY file.")
    if file.suffix.lower() not in FORMATS:
        raise InputError(f"{file} is no mesh that can be read here; export it as STL, OBJ or PLY.")
    if file.stat().st_size > MOST_BYTES:
        raise InputError(f"{file} is larger than {MOST_BYTES // 2**20} MB; simplify it.")
    refuse_pointer(file)
    try:
        mesh = trimesh.load_mesh(file, process=False, skip_materials=True)  # no other file is opened
    except Exception as e:
        raise InputError(f"{file} cannot be read as a mesh ({e}); export it again as STL, OBJ or PLY.") from e
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise InputError(f"{file} is empty: it holds no triangles.")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{file} has vertices that are not finite numbers; export it again.")
    if len(mesh.faces) > MOST_FACES:
        raise InputError(f"{file} has {len(mesh.faces)} triangles; simplify it to at most {MOST_FACES}.")
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
