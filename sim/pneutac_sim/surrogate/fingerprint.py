"""Which twin a network was trained for: what its material points depend on, as one hash."""

import hashlib
import json

import numpy as np

from pneutac_sim.gel.force import MATERIAL, MODULUS
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm.solid import parameter
from pneutac_sim.mpm.user_mesh import FACES, VERTICES
from pneutac_sim.twin import Twin

MODEL = 1  # raised where the material points themselves change, so that networks are trained again
BODY = "youngs_modulus_mpa", "poissons_ratio", "density_kg_m3", "width_mm"
BODY += "spine_stiffness_nm_per_rad", "spine_damping_nms_per_rad"
GEL = ("gel_poissons_ratio", "gel_density_kg_m3")


def fingerprint(twin: Twin, modulus_mpa: float | None = None) -> str:
    """SHA-256 of what the action network of a finger depends on: its geometry, mesh and material.

    The body knows only how it is bent. Drive, effects and history decide how far, and `in_range` shows where
    that is farther than in training. `modulus_mpa` takes the place of the twin's own.
    """
    body = {n: parameter(twin, n) for n in BODY}
    if modulus_mpa is not None:
        body["youngs_modulus_mpa"] = modulus_mpa
    what = {"model": MODEL, "device": twin.device, "length_mm": twin.length_mm, "body": body}
    what["spine_joint_positions_mm"] = list(twin.spine_joint_positions_mm)
    arrays = [np.ascontiguousarray(twin.arrays[n]) for n in (VERTICES, FACES) if n in twin.arrays]
    return _sha256(what, arrays)


def gel_fingerprint(twin: Twin) -> str:
    """SHA-256 of what the perception network of a gel depends on: material, window and thickness.

    Its modulus scales all forces and moves nothing: the default is hashed in its place, as networks of
    earlier versions have it.
    """
    gel = GelModel.from_twin(twin)
    body = {n: parameter(twin, n) for n in GEL} | {MODULUS: MATERIAL[MODULUS]}
    what = {"model": MODEL, "body": body, "window_mm": list(gel.window_mm), "thickness_mm": gel.thickness_mm}
    return _sha256(what, [])


def _sha256(what: dict, arrays: list[np.ndarray]) -> str:
    h = hashlib.sha256(json.dumps(_floats(what), sort_keys=True).encode())
    for a in arrays:
        h.update(f"{a.dtype}{a.shape}".encode())
        h.update(a.tobytes())
    return h.hexdigest()


def _floats(x):
    if isinstance(x, dict):
        return {k: _floats(v) for k, v in x.items()}
    if isinstance(x, list):
        return [_floats(v) for v in x]
    return x if isinstance(x, str) else float(x)
