"""Bench recordings with photographs of a finger or an arm whose parameters are hidden.

    recording = write_photographs("outputs/photos", seed=3)
    camera, (image, mask) = read_camera(recording, "front"), read_photograph(recording, 0, "front")

The body is brought to rest by full material points at each pressure, its surface mesh follows them, and
MuJoCo photographs it from all sides. What the twin has to find is in `truth/<name>.json` next to the folder.
An effect is hidden in it so, here with two photographs a pressure, 2 s and 60 s after the step:

    creeping = Disturbances(effects={"creep": {"weight_4s": 0.06, "weight_40s": 0.08}})
    write_photographs("outputs/photos", seed=3, disturbances=creeping, after_s=(2, 60))

Which hidden device is photographed under which pressures, and how its joints follow them.

Where the cameras of generated photographs stand, and where they stand after they were knocked.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from pneutac_datasets.generate.finger import write_truth
from pneutac_datasets.generate.photo_scene import Studio, photograph, ragged
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.effect import BODY_STAGES
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.inputs import Inputs, pressure_columns
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solid import SHAPES
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.follow import carry
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

WIDTH, HEIGHT = 640, 480
# Camera: the way it looks and the way up in the picture, base frame. Devices hang from their base.
VIEWS = {"front": (0, 1, 0), "back": (0, -1, 0), "side": (0, 0, -1)}
CAMERAS = {"finger": ("front", "back"), "arm": ("front", "back", "side")}


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


def knocked(camera: Camera, turn_deg: float, shift_mm: float, rng: np.random.Generator) -> Camera:
    """The camera turned about its eye and shifted, in directions by chance."""

    def way(size):
        v = rng.normal(size=3)
        return size * v / np.linalg.norm(v)

    nominal = camera.extrinsics
    eye = -nominal[:3, :3].T @ nominal[:3, 3] + 1e-3 * way(shift_mm)
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = Rotation.from_rotvec(np.radians(way(turn_deg))).as_matrix() @ nominal[:3, :3]
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ eye
    return Camera(camera.intrinsics, extrinsics, camera.width, camera.height)


PRESSURES_KPA = tuple(float(p) for p in range(16))


def hidden_twin(seed: int, device: str) -> Twin:
    """A finger or arm with parameters around the paper's calibrated ones (Sec. IV-A), by a seed."""
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


def session(pressure: np.ndarray, device: str, after_s: tuple[float, ...], conditions: dict) -> pd.DataFrame:
    """When the device is photographed under which pressure: the recording's table without what is seen."""
    pressure = pressure[:, None] if pressure.ndim == 1 else pressure
    times = np.asarray(after_s, float)
    if len(times) and not (np.isfinite(times).all() and (np.diff(times, prepend=0.0) > 0).all()):
        raise InputError(f"after_s is {times.tolist()}; give rising times above 0 s, such as (2, 60).")
    if pressure.ndim != 2 or pressure.shape[1] != CHAMBERS[device] or not np.isfinite(pressure).all():
        raise InputError(
            f"pressures_kpa must be rows of {CHAMBERS[device]} finite numbers, one a chamber of the {device}."
        )
    count, each = len(pressure), max(len(times), 1)
    table = {"trial": np.arange(count), "time_s": np.zeros(count)}
    if len(times):
        began_s = times[-1] * np.arange(count)[:, None]
        table = {"trial": np.zeros(count * each, int), "time_s": (began_s + times).ravel()}
    table |= dict(zip(pressure_columns(device)[0], np.repeat(pressure, each, 0).T, strict=True))
    for name, value in conditions.items():
        table[name] = np.repeat(np.broadcast_to(np.asarray(value, float), count), each)
    return pd.DataFrame(table)


def joints_of(twin: Twin, samples: pd.DataFrame) -> np.ndarray:
    """(n, H) rad of the joint targets at each sample of a recording, as it went.

    Raises:
        InputError: an effect of the twin asks for a column that is not there.
    """
    inputs = Inputs.from_samples(samples, twin.device, twin.length_mm, source="command", start="held")
    pipeline = Pipeline.of(twin, inputs)
    for name, why in pipeline.left_out.items():
        raise InputError(f"The twin's effect '{name}' cannot act: {why}.")
    return pipeline.run(inputs, pipeline.theta(twin)).joints


MARKER_NOISE_MM = 0.3


@dataclass(frozen=True)
class Disturbances:
    """What can be wrong with a session, none of it stated in `recording.json`."""

    # effect of the body to its parameters; those left out do nothing
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    tilt_deg: float = 0.0  # by which the base is turned about y in its mount
    camera_deg: float = 0.0  # by which each camera is turned from where the recording says
    camera_mm: float = 0.0  # by which it is moved
    mask_px: float = 0.0  # by which the edge of the masks wanders

    def __post_init__(self):
        for name in self.effects:
            if get_effect(name).stage not in BODY_STAGES or get_effect(name).of_markers:
                raise InputError(
                    f"Disturbances: effect '{name}' does not act on the body; tilt_deg turns the base, "
                    "camera_deg and camera_mm move the cameras."
                )
        for name in ("tilt_deg", "camera_deg", "camera_mm", "mask_px"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"Disturbances: {name} is {value}; it must be 0 or a positive number.")


def write_photographs(
    folder: str | Path,
    seed: int,
    device: str = "finger",
    pressures_kpa=None,
    disturbances: Disturbances | None = None,
    particles: int = 6000,
    after_s: tuple[float, ...] = (),
    conditions: dict | None = None,
) -> Recording:
    """Photographs a hidden device at each pressure.

    By default each is held for long by itself (one trial a pressure). With `after_s` all are one trial, in
    the order given: the pressure changes evenly until the first of these times and then stays.

    Args:
        folder: of the recording.
        seed: decides parameters, looks, lamps, cameras and noise.
        device: `finger` or `arm`.
        pressures_kpa: (T,), or (T, 3) of an arm; None for `default_pressures`.
        disturbances: what is wrong with the session; None for nothing.
        particles: of the hidden body, about; not those of a twin, whose lattice would be the same.
        after_s: rising times after each step at which it is photographed; the last is that of the next step.
        conditions: further columns of the recording, such as `gravity_x`: a number, or (T,) numbers.

    Returns:
        The recording: `image_front`, `mask_front` and so on, `tip_x_mm, tip_y_mm, tip_z_mm` with noise; each
        camera's `background` is a photograph without the body.

    Raises:
        InputError: another device, pressures that are no finite numbers, times that do not rise, or an effect
            that lacks a condition.
    """
    twin, wrong = hidden_twin(seed, device), disturbances or Disturbances()
    for name, values in wrong.effects.items():
        twin.effects[name] = get_effect(name).neutral() | {k: Value(float(v)) for k, v in values.items()}
    pressure = default_pressures(device) if pressures_kpa is None else np.asarray(pressures_kpa, float)
    table = session(pressure, device, after_s, conditions or {})
    meshes, rest, q, tips = bent_meshes(twin, joints_of(twin, table), particles)
    tips = _tilted(wrong.tilt_deg, meshes, 1e3 * tips)
    rng = np.random.default_rng([seed, 12])
    length, width = 1e-3 * twin.length_mm, 1e-3 * devices.parameter(twin, "width_mm")
    studio = Studio.random(rng, length, width)
    nominal = {name: place_camera(name, length, rng) for name in CAMERAS[device]}
    actual = {n: knocked(c, wrong.camera_deg, wrong.camera_mm, rng) for n, c in nominal.items()}
    folder = Path(folder)
    observed = _photograph_all(folder, meshes, rest, studio, actual, tips, wrong.mask_px, rng)
    samples = pd.concat([table, pd.DataFrame(observed)], axis=1)
    Recording(folder, _metadata(twin, nominal), samples, device).write(folder)
    truth = {
        "parameters": {k: v.value for k, v in twin.parameters.items()},
        "joints_rad": q.tolist(),
        "tips_mm": tips.tolist(),
        "disturbances": asdict(wrong),
        "camera_extrinsics": {name: c.extrinsics.tolist() for name, c in actual.items()},
        "seed": seed,
        "recording": folder.name,
    }
    write_truth(folder, truth)
    return Recording.load(folder)


def _tilted(tilt_deg: float, meshes: list[trimesh.Trimesh], tips_mm: np.ndarray) -> np.ndarray:
    """Turns the meshes, in place, and the tips (T, 3) with a base that is turned about y in its mount."""
    turn = Rotation.from_euler("y", -tilt_deg, degrees=True).as_matrix()
    for mesh in meshes:
        mesh.vertices = mesh.vertices @ turn.T
    return tips_mm @ turn.T


def _photograph_all(folder, meshes, rest, studio, cameras, tips_mm, mask_px, rng) -> list[dict]:
    """Photographs the empty bench and each mesh by each camera; returns the columns of each sample."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for name, camera in cameras.items():
        Image.fromarray(photograph(None, rest, studio, camera, rng)[0]).save(folder / _empty(name))
    observed = []
    for i, mesh in enumerate(meshes):
        columns = {}
        for name, camera in cameras.items():
            image, mask = photograph(mesh, rest, studio, camera, rng)
            mask = ragged(mask, mask_px, rng)
            for kind, picture in (("image", image), ("mask", np.uint8(255) * mask)):
                columns[f"{kind}_{name}"] = f"images/{i:03d}_{kind}_{name}.png"
                Image.fromarray(picture).save(folder / columns[f"{kind}_{name}"])
        tip = tips_mm[i] + MARKER_NOISE_MM * rng.normal(size=3)
        observed.append(columns | {f"tip_{a}_mm": x for a, x in zip("xyz", tip, strict=True)})
    return observed


def _metadata(twin: Twin, cameras: dict[str, Camera]) -> dict:
    """`recording.json`, with the cameras where they are believed to stand."""
    return {
        "device": twin.device,
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
            for name, c in cameras.items()
        },
        "notes": "Generated.",
    }


def _empty(camera: str) -> str:
    return f"images/empty_{camera}.png"


def bent_meshes(
    twin: Twin, q_cmd: np.ndarray, particles: int = 6000
) -> tuple[list[trimesh.Trimesh], np.ndarray, np.ndarray, np.ndarray]:
    """Surface meshes of a twin's body at rest under joint targets (T, H) rad, by full material points.

    Returns:
        T meshes (m), the vertices (V, 3) of the straight one, the joint angles (T, H) at rest, rad, and the
        spine's tips (T, 3), m.
    """
    solver = devices.BODIES[twin.device](twin, batch=len(q_cmd), particles=particles)
    state = solve_equilibrium(solver, Loads(q_cmd=q_cmd))
    width = 1e-3 * devices.parameter(twin, "width_mm")
    straight = SHAPES[twin.device](1e-3 * twin.length_mm, width).subdivide()
    moved = carry(straight.vertices, solver.body.positions, state.positions, state.gradients)
    meshes = [trimesh.Trimesh(x, straight.faces, process=False) for x in moved]
    return meshes, np.asarray(straight.vertices), state.q, devices.spine_points(solver, state.q)[:, -1]
