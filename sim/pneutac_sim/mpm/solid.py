"""The soft solid of a finger or an arm: its particles, and what of them each link carries.

Closed meshes of devices, in m: x along the straight device, axis at y = z = 0; a gel in its own frame.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.gel.force import MATERIAL
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.user_mesh import stored_mesh
from pneutac_sim.twin import PAPER_FINGER, Twin

WIDTH_MM = {"finger": 20.0, "arm": 40.0}
# A twin's parameters where it has none. Moduli of the finger: the paper's calibrated ones;
# density: Agilus30's data sheet; the gel's are in `gel.force`.
DEFAULTS = {
    "youngs_modulus_mpa": PAPER_FINGER["youngs_modulus_mpa"],
    "poissons_ratio": PAPER_FINGER["poissons_ratio"],
    "density_kg_m3": 1145.0,
    "spine_damping_nms_per_rad": 0.01,
    **MATERIAL,
    "gel_density_kg_m3": 1070.0,
}
# The controller is stiff against the body (0.07 to 0.29 N m/rad a joint of the finger), which takes back
# 1.6 % of its bend; with a soft one the search for rest takes far longer.
BY_DEVICE = {"width_mm": WIDTH_MM, "spine_stiffness_nm_per_rad": {"finger": 20.0, "arm": 200.0}}


def parameter(twin: Twin, name: str) -> float:
    """The twin's value, or the default of `DEFAULTS` or `BY_DEVICE`."""
    if name in twin.parameters:
        return twin.parameters[name].value
    return BY_DEVICE[name][twin.device] if name in BY_DEVICE else DEFAULTS[name]


# DIGIT's housing is 27 x 20 x 18 mm (Lambeta et al. 2020); it lies beyond the tip, back against the mount.
DIGIT_LENGTH_M, DIGIT_HALF_HEIGHT_M = 0.027, 0.009
MOUNT_OVERLAP_M, MOUNT_WALL_M, MOUNT_PLAY_M = 0.012, 0.003, 0.0002
PITCH_M = 0.0095  # of the bellows
STATIONS_A_RING = 4
ANGLES = 24


def body_mesh(twin: Twin) -> trimesh.Trimesh:
    """The closed mesh of a twin's soft body: its own where it holds one, else the parametric device's."""
    own = stored_mesh(twin)
    if own is not None:
        return own
    if twin.device == "gel":
        model = GelModel.from_twin(twin)
        # a block under its window, in the gel frame of `gel.probe`: the resting surface is at z = 0
        block = trimesh.creation.box(1e-3 * np.array([*model.window_mm, model.thickness_mm]))
        return block.apply_translation((0, 0, -0.5e-3 * model.thickness_mm))
    return SHAPES[twin.device](1e-3 * twin.length_mm, 1e-3 * parameter(twin, "width_mm"))


def finger_mesh(length_m: float, width_m: float) -> trimesh.Trimesh:
    """A bar with a rounded square section, `width_m` wide: bellows above and beside, flat below (-z)."""
    angle = np.linspace(0, 2 * np.pi, ANGLES, endpoint=False)
    y, z = np.cos(angle), np.sin(angle)
    rounded = 0.5 * width_m / (y**4 + z**4) ** 0.25
    # Folds cut in where the section looks up, half as deep at the sides, not at all below.
    return _tube(length_m, np.stack([rounded * y, rounded * z], 1), 0.22 * np.clip(0.6 + z, 0, 1))


def arm_mesh(length_m: float, width_m: float) -> trimesh.Trimesh:
    """Three bellows round the axis: a section of three lobes, `width_m` across, the first towards +z."""
    angle = np.linspace(0, 2 * np.pi, ANGLES, endpoint=False)
    lobes = np.cos(3 * (angle - np.pi / 2))
    section = 0.5 * width_m * (0.9 + 0.1 * lobes)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    return _tube(length_m, section, 0.15 * np.ones(ANGLES))


SHAPES = {"finger": finger_mesh, "arm": arm_mesh}


def digit_mount_mesh(length_m: float, width_m: float) -> trimesh.Trimesh:
    """A rigid channel under the last 12 mm of a finger's flat spine and a DIGIT's housing beyond its tip."""
    inner = width_m / 2 + MOUNT_PLAY_M
    outer = inner + MOUNT_WALL_M
    floor, top = -inner, DIGIT_HALF_HEIGHT_M - inner
    section = [(-outer, floor - MOUNT_WALL_M), (outer, floor - MOUNT_WALL_M), (outer, top), (inner, top)]
    section += [(inner, floor), (-inner, floor), (-inner, top), (-outer, top)]
    x = np.repeat([length_m - MOUNT_OVERLAP_M, length_m + DIGIT_LENGTH_M], len(section))
    vertices = np.column_stack([x, np.tile(section, (2, 1))])
    here = np.arange(len(section))
    next_ = np.roll(here, -1)
    far, far_next = here + len(section), next_ + len(section)
    sides = np.concatenate([np.stack([here, next_, far_next], 1), np.stack([here, far_next, far], 1)])
    end = np.array([(0, 1, 4), (0, 4, 5), (1, 2, 3), (1, 3, 4), (0, 5, 6), (0, 6, 7)])
    mesh = trimesh.Trimesh(vertices, np.concatenate([sides, end[:, ::-1], end + len(section)]), process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _tube(length_m: float, section: np.ndarray, depth: np.ndarray) -> trimesh.Trimesh:
    """Sweeps a section (A, 2), drawn in by the share `depth` (A,) at each fold, along x; ends are closed."""
    rings = max(1, round(length_m / PITCH_M))
    share = np.linspace(0, 1, rings * STATIONS_A_RING + 1)
    fold = 0.5 + 0.5 * np.cos(2 * np.pi * rings * share)  # 1 in a fold
    fold[share < 0.5 / rings] = fold[share > 1 - 0.5 / rings] = 0.0  # full ends
    points = section * (1 - fold[:, None, None] * depth[:, None])
    x = np.broadcast_to((share * length_m)[:, None, None], (*points.shape[:2], 1))
    vertices = np.concatenate([np.concatenate([x, points], -1).reshape(-1, 3), [[0, 0, 0], [length_m, 0, 0]]])
    count = len(section)
    s, a = np.meshgrid(np.arange(len(share) - 1), np.arange(count), indexing="ij")
    here, next_ = s * count + a, s * count + (a + 1) % count
    sides = np.stack([here, next_, here + count, next_, next_ + count, here + count], -1)
    ring, first, last = np.arange(count), len(vertices) - 2, len(vertices) - 1
    after = (ring + 1) % count
    end = (len(share) - 1) * count
    base = np.stack([np.full_like(ring, first), after, ring], 1)
    tip = np.stack([np.full_like(ring, last), end + ring, end + after], 1)
    mesh = trimesh.Trimesh(vertices, np.concatenate([sides.reshape(-1, 3), base, tip]), process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def bending_body(twin: Twin, particles: int = 4000, mesh=None) -> Body:
    """The straight particles of a finger or an arm; `particles` and `mesh` as in `devices.finger`.

    Raises InputError: an impossible mesh or parameter.
    """
    search = mesh is None and stored_mesh(twin) is not None
    mesh = body_mesh(twin) if mesh is None else mesh
    return Body.from_mesh(twin.device, mesh, material_of(twin), particles, "x-", search)


def material_of(twin: Twin, prefix: str = "") -> Material:
    """The material of a twin's body, or of its gel by the prefix `gel_`."""
    E, nu, rho = (
        parameter(twin, prefix + n) for n in ("youngs_modulus_mpa", "poissons_ratio", "density_kg_m3")
    )
    return Material(1e6 * E, nu, rho)


@dataclass(frozen=True)
class Links:
    """What each of N + 1 links of a spine carries; link 0 is held at the base."""

    mass_kg: np.ndarray  # (N + 1,)
    centre_m: np.ndarray  # (N + 1, 3) of mass, straight finger, m
    inertia_kg_m2: np.ndarray  # (N + 1, 3, 3) about it

    @classmethod
    def of(cls, body: Body, joints_m) -> "Links":
        """Each particle of a straight body along x, a cube of its spacing, goes with its nearest link.

        The joints lie at (N,) ascending places along x, m.

        Raises InputError where a link that moves carries no particle.
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
