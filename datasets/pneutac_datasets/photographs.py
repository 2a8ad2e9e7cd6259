"""Bench recordings with photographs of a finger or an arm whose parameters are hidden.

    recording = write_photographs("outputs/photos", seed=3)
    camera, (image, mask) = read_camera(recording, "front"), read_photograph(recording, 0, "front")

The body is brought to rest by full material points at each pressure, its surface mesh follows them, and
MuJoCo photographs it from all sides. What the twin has to find lies in `truth/<name>.json` beside the folder.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from pneutac_datasets.photo_scene import Studio, photograph, ragged
from pneutac_datasets.recording import BenchRecording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.inputs import CHAMBERS, pressure_columns
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.carry import carry
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

PRESSURES_KPA = tuple(float(p) for p in range(16))
MARKER_NOISE_MM = 0.3
WIDTH, HEIGHT = 640, 480
# Camera: the way it looks and the way up in the picture, base frame. Devices hang from their base.
VIEWS = {"front": (0, 1, 0), "back": (0, -1, 0), "side": (0, 0, -1)}
CAMERAS = {"finger": ("front", "back"), "arm": ("front", "back", "side")}


@dataclass(frozen=True)
class Disturbances:
    """What can be wrong with a session, none of it told in `recording.json`.

    Attributes:
        weight_g: mass along the body that bends it, as it hangs 30 degrees off the vertical.
        tilt_deg: by which the base is turned about y in its mount.
        camera_deg: by which each camera is turned from where the recording says.
        camera_mm: by which it is moved.
        mask_px: by which the edge of the masks wanders.
    """

    weight_g: float = 0.0
    tilt_deg: float = 0.0
    camera_deg: float = 0.0
    camera_mm: float = 0.0
    mask_px: float = 0.0

    def __post_init__(self):
        for name, value in asdict(self).items():
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"Disturbances: {name} is {value}; it must be 0 or a positive number.")


def hidden_twin(seed: int, device: str) -> Twin:
    """A device with parameters around the paper's calibrated ones (Sec. IV-A).

    Args:
        seed: decides them.
        device: `finger` or `arm`.
    """
    if device not in CAMERAS:
        raise InputError(f"There are no photographs of a '{device}'; choose finger or arm.")
    rng = np.random.default_rng([seed, 11])
    p = PAPER_FINGER
    scale, even, straight = {"finger": (1.0, 1.0, 1.0), "arm": (0.7, 0.3, 0.1)}[device]
    values = {
        "gain_rad_per_kpa": scale * p["gain_rad_per_kpa"] * rng.uniform(0.8, 1.25),
        "gain_alpha": p["gain_alpha"] + rng.uniform(-0.06, 0.06),
        "gain_beta": p["gain_beta"] * rng.uniform(0.5, 1.2) * even,
        "rest_pressure_kpa": straight * p["rest_pressure_kpa"] * rng.uniform(0.6, 1.2),
        "youngs_modulus_mpa": p["youngs_modulus_mpa"] * rng.uniform(0.7, 1.4),
        "poissons_ratio": p["poissons_ratio"] + rng.uniform(-0.04, 0.02),
        "joint_stiffness_nm_per_rad": p["joint_stiffness_nm_per_rad"] * rng.uniform(0.8, 1.25),
    }
    length = {"finger": 110.0, "arm": 200.0}[device]
    return Twin(device, length, parameters={k: Value(float(v)) for k, v in values.items()})


def default_pressures(device: str) -> np.ndarray:
    """(T, chambers) kPa: 0 to 15 kPa in steps of 1; of an arm in steps of 3, each chamber by itself."""
    if CHAMBERS[device] == 1:
        return np.array(PRESSURES_KPA)[:, None]
    one = np.array(PRESSURES_KPA[::3])
    rows = [np.zeros((1, CHAMBERS[device]))]
    rows += [p * np.eye(CHAMBERS[device])[[c]] for c in range(CHAMBERS[device]) for p in one[1:]]
    return np.concatenate(rows)


def write_photographs(
    folder: str | Path,
    seed: int,
    device: str = "finger",
    pressures_kpa=None,
    disturbances: Disturbances | None = None,
    particles: int = 6000,
) -> BenchRecording:
    """Photographs a hidden device at each pressure, returning it to rest in between (one trial a pressure).

    Args:
        folder: of the recording.
        seed: decides parameters, looks, lamps, cameras and noise.
        device: `finger` or `arm`.
        pressures_kpa: (T,), or (T, 3) of an arm; None for `default_pressures`.
        disturbances: what is wrong with the session; None for nothing.
        particles: of the hidden body, about; not those of a twin, whose lattice would be the same.

    Returns:
        The recording: `image_front`, `mask_front` and so on, `tip_x_mm, tip_y_mm, tip_z_mm` with noise; each
        camera's `background` is a photograph without the body.

    Raises:
        InputError: another device, or pressures that are no finite numbers.
    """
    twin, wrong = hidden_twin(seed, device), disturbances or Disturbances()
    pressure = default_pressures(device) if pressures_kpa is None else np.asarray(pressures_kpa, float)
    pressure = pressure[:, None] if pressure.ndim == 1 else pressure
    conditions = None
    if wrong.weight_g:
        twin.effects["gravity"] = {p.name: Value(0.0) for p in get_effect("gravity").parameters}
        twin.effects["gravity"]["body_mass_g"] = Value(wrong.weight_g)
        conditions = dict(zip(("gravity_x", "gravity_y", "gravity_z"), (0.866, 0.0, -0.5), strict=True))
    meshes, rest, tips = bent_meshes(twin, pressure, conditions, particles)
    tilt = Rotation.from_euler("y", -wrong.tilt_deg, degrees=True).as_matrix()
    rng = np.random.default_rng([seed, 12])
    length = 1e-3 * twin.length_mm
    width = 1e-3 * devices.parameter(twin, "width_mm")
    studio = Studio.random(rng, length, width)
    told = {name: place_camera(name, length, rng) for name in CAMERAS[device]}
    true = {name: _knocked(camera, wrong, rng) for name, camera in told.items()}
    folder = Path(folder)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for name, camera in true.items():
        Image.fromarray(photograph(None, rest, studio, camera, rng)[0]).save(folder / _empty(name))
    rows = []
    for i, mesh in enumerate(meshes):
        mesh.vertices = mesh.vertices @ tilt.T
        row = {"trial": i, "time_s": 0.0}
        row |= dict(zip(pressure_columns(device)[0], pressure[i], strict=True))
        for name, camera in true.items():
            image, mask = photograph(mesh, rest, studio, camera, rng)
            mask = ragged(mask, wrong.mask_px, rng)
            for kind, picture in (("image", image), ("mask", np.uint8(255) * mask)):
                row[f"{kind}_{name}"] = f"images/{i:03d}_{kind}_{name}.png"
                Image.fromarray(picture).save(folder / row[f"{kind}_{name}"])
        tip = 1e3 * tilt @ tips[i] + MARKER_NOISE_MM * rng.normal(size=3)
        rows.append(row | {f"tip_{a}_mm": x for a, x in zip("xyz", tip, strict=True)})
    meta = {
        "device": device,
        "length_mm": twin.length_mm,
        "spine_joint_positions_mm": list(twin.spine_joint_positions_mm),
        "samples": "samples.csv",
        "noise": {f"tip_{a}_mm": MARKER_NOISE_MM for a in "xyz"},
        "cameras": {
            name: {
                "intrinsics": c.intrinsics.tolist(),
                "extrinsics": c.extrinsics.tolist(),
                "background": _empty(name),
            }
            for name, c in told.items()
        },
        "notes": "Generated.",
    }
    BenchRecording(folder, meta, pd.DataFrame(rows), device).write(folder)
    truth = {
        "parameters": {k: v.value for k, v in twin.parameters.items()},
        "disturbances": asdict(wrong),
        "camera_extrinsics": {name: c.extrinsics.tolist() for name, c in true.items()},
        "seed": seed,
        "recording": folder.name,
    }
    file = folder.parent / "truth" / f"{folder.name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(truth, indent=1) + "\n")
    return BenchRecording.load(folder)


def _empty(camera: str) -> str:
    return f"images/empty_{camera}.png"


def bent_meshes(
    twin: Twin, pressure_kpa: np.ndarray, conditions: dict | None = None, particles: int = 6000
) -> tuple[list[trimesh.Trimesh], np.ndarray, np.ndarray]:
    """Surface meshes of a device at rest under pressures, by full material points.

    Args:
        twin: a finger's or an arm's.
        pressure_kpa: (T, chambers).
        conditions: what the twin's effects ask for.
        particles: about how many.

    Returns:
        T meshes (m), the vertices (V, 3) of the straight one, and the spine's tips (T, 3), m.
    """
    q = devices.joint_targets(twin, pressure_kpa, conditions=conditions)
    build = {"finger": devices.finger, "arm": devices.arm}[twin.device]
    solver = build(twin, batch=len(q), particles=particles)
    state = solve_equilibrium(solver, Loads(q_cmd=q))
    width = 1e-3 * devices.parameter(twin, "width_mm")
    straight = devices.SHAPES[twin.device](1e-3 * twin.length_mm, width).subdivide()
    moved = carry(straight.vertices, solver.body.positions, state.positions, state.gradients)
    meshes = [trimesh.Trimesh(x, straight.faces, process=False) for x in moved]
    return meshes, np.asarray(straight.vertices), devices.spine_points(solver, state.q)[:, -1]


def place_camera(name: str, length_m: float, rng: np.random.Generator) -> Camera:
    """A camera of one of `VIEWS` in the base frame, placed by hand, so a few degrees off."""
    forward = np.array(VIEWS[name], float)
    down = np.array([1.0, 0.0, 0.0])
    turn = np.stack([np.cross(down, forward), down, forward])  # rows: right, down, forward
    turn = Rotation.from_euler("xyz", rng.uniform(-4, 4, 3), degrees=True).as_matrix() @ turn
    distance = 4 * length_m
    aim = length_m * np.array([0.5, 0.0, 0.0 if name == "side" else 0.22])
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = turn
    extrinsics[:3, 3] = np.array([0, 0, distance]) - turn @ aim + rng.uniform(-0.01, 0.01, 3) * length_m
    focal = 0.8 * HEIGHT / length_m * distance
    intrinsics = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    return Camera(intrinsics, extrinsics, WIDTH, HEIGHT)


def _knocked(camera: Camera, wrong: Disturbances, rng: np.random.Generator) -> Camera:
    """Where the camera is since it was knocked after its calibration."""

    def way(size):
        v = rng.normal(size=3)
        return size * v / np.linalg.norm(v)

    told = camera.extrinsics
    eye = -told[:3, :3].T @ told[:3, 3] + 1e-3 * way(wrong.camera_mm)
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = Rotation.from_rotvec(np.radians(way(wrong.camera_deg))).as_matrix() @ told[:3, :3]
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ eye
    return Camera(camera.intrinsics, extrinsics, camera.width, camera.height)
