"""Bench recordings with photographs of a finger or an arm whose parameters are hidden.

    recording = write_photographs("outputs/photos", seed=3)
    camera, (image, mask) = read_camera(recording, "front"), read_photograph(recording, 0, "front")

The body is brought to rest by full material points at each pressure, its surface mesh follows them, and
MuJoCo photographs it from all sides. What the twin has to find is in `truth/<name>.json` next to the folder.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pandas as pd
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from pneutac_datasets.generate.finger import write_truth
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.effect import BODY_STAGES
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError, check_between
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.inputs import pressure_columns
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solid import PITCH_M, SHAPES
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.splat.body import Carrier
from pneutac_sim.splat.camera import Camera
from pneutac_sim.twin import PAPER_FINGER, Twin, Value
from pneutac_sim.world.view import Renderer

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
    shift, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    nominal = camera.extrinsics
    eye = -nominal[:3, :3].T @ nominal[:3, 3] + 1e-3 * shift_mm * shift
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = Rotation.from_rotvec(np.radians(turn_deg * turn)).as_matrix() @ nominal[:3, :3]
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
    alone = np.eye(CHAMBERS[device])
    return np.stack([0 * alone[0], *(p * row for row in alone for p in PRESSURES_KPA[3::3])])


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
                other = "tilt_deg turns the base, camera_deg and camera_mm move the cameras"
                raise InputError(f"Disturbances: effect '{name}' does not act on the body; {other}.")
        for name in ("tilt_deg", "camera_deg", "camera_mm", "mask_px"):
            check_between(0, 1000, **{f"Disturbances: {name}": getattr(self, name)})


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
    """Photographs a hidden device, `finger` or `arm`, at pressures (T,) or (T, 3) kPa.

    By default each is held for long by itself (one trial a pressure). With `after_s`, rising times after each
    step, all are one trial, in the order given: the pressure changes evenly until the first of these times
    and then stays; the last is that of the next step. The hidden body has about so many particles, not those
    of a twin, whose lattice would be the same; `conditions` are further columns, a number or (T,) numbers
    each.

    The recording has `image_front`, `mask_front` and so on, `tip_x_mm, tip_y_mm, tip_z_mm` with noise; each
    camera's `background` is a photograph without the body. Raises InputError for another device, pressures
    that are no finite numbers, times that do not rise, or an effect that lacks a condition.
    """
    twin, wrong = hidden_twin(seed, device), disturbances or Disturbances()
    for name, values in wrong.effects.items():
        twin.effects[name] = get_effect(name).neutral() | {k: Value(float(v)) for k, v in values.items()}
    pressure = default_pressures(device) if pressures_kpa is None else np.asarray(pressures_kpa, float)
    table = session(pressure, device, after_s, conditions or {})
    meshes, rest, q, tips = bent_meshes(twin, devices.sampled_targets(twin, table), particles)
    turn = Rotation.from_euler("y", -wrong.tilt_deg, degrees=True).as_matrix()
    for mesh in meshes:
        mesh.vertices = mesh.vertices @ turn.T
    tips = 1e3 * tips @ turn.T
    rng = np.random.default_rng([seed, 12])
    length, width = 1e-3 * twin.length_mm, 1e-3 * devices.parameter(twin, "width_mm")
    studio = Studio.random(rng, length, width)
    nominal = {name: place_camera(name, length, rng) for name in CAMERAS[device]}
    actual = {n: knocked(c, wrong.camera_deg, wrong.camera_mm, rng) for n, c in nominal.items()}
    folder = Path(folder)
    observed = _photograph_all(folder, meshes, rest, studio, actual, tips, wrong.mask_px, rng)
    samples = pd.concat([table, pd.DataFrame(observed)], axis=1)
    Recording(folder, _metadata(twin, nominal), samples, device).write(folder)
    truth = {"parameters": {k: v.value for k, v in twin.parameters.items()}, "joints_rad": q.tolist()}
    truth |= {"tips_mm": tips.tolist(), "disturbances": asdict(wrong)}
    truth["camera_extrinsics"] = {name: c.extrinsics.tolist() for name, c in actual.items()}
    write_truth(folder, truth | {"seed": seed, "recording": folder.name})
    return Recording.load(folder)


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
    described = {
        name: {k: getattr(c, k).tolist() for k in ("intrinsics", "extrinsics")} | {"background": _empty(name)}
        for name, c in cameras.items()
    }
    meta = {name: getattr(twin, name) for name in ("device", "length_mm", "spine_joint_positions_mm")}
    meta |= {"samples": "samples.csv", "noise": {f"tip_{a}_mm": MARKER_NOISE_MM for a in "xyz"}}
    return meta | {"cameras": described, "notes": "Generated."}


def _empty(camera: str) -> str:
    return f"images/empty_{camera}.png"


def bent_meshes(
    twin: Twin, q_cmd: np.ndarray, particles: int = 6000
) -> tuple[list[trimesh.Trimesh], np.ndarray, np.ndarray, np.ndarray]:
    """Surface meshes of a twin's body at rest under joint targets (T, H) rad, by full material points.

    T meshes (m), the vertices (V, 3) of the straight one, the joint angles (T, H) at rest, rad, and the
    spine's tips (T, 3), m.
    """
    solver = devices.BODIES[twin.device](twin, batch=len(q_cmd), particles=particles)
    state = solve_equilibrium(solver, Loads(q_cmd=q_cmd))
    width = 1e-3 * devices.parameter(twin, "width_mm")
    straight = SHAPES[twin.device](1e-3 * twin.length_mm, width).subdivide()
    moved = Carrier(straight.vertices, solver.body.positions)(state.positions, state.gradients)
    meshes = [trimesh.Trimesh(x, straight.faces, process=False) for x in moved]
    return meshes, np.asarray(straight.vertices), state.q, devices.spine_points(solver, state.q)[:, -1]


def printed_texture(rng: np.random.Generator, length_m: float) -> np.ndarray:
    """Texture of a printed body: layers, dirty folds, a label, a tape, and a sensor's housing at its tip.

    Returns:
        uint8 (V, U, 3): columns along the body, rows round its axis from +y to +z.
    """
    rows, columns = 512, 1536
    hue = rng.uniform(0, 180)
    base = cv2.cvtColor(np.uint8([[[hue, rng.uniform(70, 150), rng.uniform(90, 150)]]]), cv2.COLOR_HSV2RGB)
    x = (np.arange(columns) + 0.5) / columns  # along
    angle = 2 * np.pi * (np.arange(rows) + 0.5) / rows

    def cloud(scale):
        seeds = rng.normal(size=(rows // scale + 2, columns // scale + 2))
        return cv2.resize(seeds, (columns, rows), interpolation=cv2.INTER_CUBIC)

    rings = max(1, round(length_m / PITCH_M))
    fold = 0.5 + 0.5 * np.cos(2 * np.pi * rings * x)
    light = 1 + 0.10 * cloud(128) + 0.05 * cloud(24) + 0.03 * rng.normal(size=(rows, columns))
    light += 0.035 * np.sin(2 * np.pi * x * length_m / 0.0006)  # layers of the printer
    light *= 1 - 0.30 * np.clip(0.6 + np.sin(angle), 0, 1)[:, None] * fold**3  # dirt in the folds
    picture = base[0, 0] * light[..., None]
    picture += cloud(64)[..., None] * rng.normal(0, 7, 3)  # uneven dye
    back = np.sin(angle) < -0.55  # the spine at the flat side is of a stiffer, paler rubber
    picture[back] = 0.55 * picture[back] + 0.45 * rng.uniform(90, 170)

    def patch(at, along, round_from, round_to, colour):
        i = (angle > round_from) & (angle < round_to)
        j = np.abs(x - at) < along / 2
        picture[np.ix_(i, j)] = colour

    front = 1.5 * np.pi, np.pi  # the side towards -y lies at the angle pi
    at = rng.uniform(0.18, 0.34)
    paper, ink = rng.uniform(205, 235, 3), rng.uniform(20, 60, 3)
    patch(at, 0.13, 0.90 * front[1], 1.12 * front[1], paper)
    for k in range(5):
        patch(at - 0.045 + 0.022 * k, 0.009, 0.94 * front[1], (1.0 + 0.015 * k) * front[1], ink)
    stripe = cv2.cvtColor(np.uint8([[[(hue + 90) % 180, 190, 200]]]), cv2.COLOR_HSV2RGB)[0, 0]
    patch(rng.uniform(0.52, 0.68), 0.025, 0, 2 * np.pi, stripe)  # a band of tape all round
    housing = cv2.cvtColor(np.uint8([[[(hue + 60) % 180, 120, rng.uniform(50, 90)]]]), cv2.COLOR_HSV2RGB)
    tip = x > 1 - 0.021 / length_m
    picture[:, tip] = housing[0, 0] * (1 + 0.04 * cloud(64)[:, tip, None])
    patch(1 - 0.007 / length_m, 0.008 / length_m, 0.15 * np.pi, 0.85 * np.pi, rng.uniform(180, 230, 3))  # gel
    return np.clip(picture, 4, 250).astype(np.uint8)


BODY = 1  # group of the body's surface, which the empty studio lacks
FINE = 2  # pixels of the renderer a pixel of the photograph, each way

_STUDIO = """
<mujoco>
  <statistic extent="1" center="0 0 0"/>
  <visual>
    <global offwidth="{w}" offheight="{h}"/>
    <quality shadowsize="2048" offsamples="0"/>
    <headlight ambient=".34 .34 .35" diffuse=".08 .08 .08" specular="0 0 0"/>
    <map znear=".05" zfar="4" shadowclip=".6"/>
  </visual>
  <asset>
    <texture name="cloth" type="2d" builtin="checker" rgb1="{cloth1}" rgb2="{cloth2}" width="128"
             height="128" mark="random" random=".05" markrgb="{cloth2}"/>
    <material name="cloth" texture="cloth" texrepeat="6 6" specular="0"/>
    <material name="mount" rgba=".16 .17 .19 1" specular=".4" shininess=".5"/>
  </asset>
  <worldbody>
    <light pos="{lamp1}" dir="{to1}" cutoff="60" exponent="1" diffuse=".95 .92 .86" specular=".35 .35 .35"/>
    <light pos="{lamp2}" dir="{to2}" cutoff="60" exponent="1" diffuse=".74 .77 .82" specular=".25 .25 .25"/>
    <light pos="{lamp3}" dir="{to3}" cutoff="70" diffuse=".34 .34 .34" specular="0 0 0" castshadow="false"/>
    <camera name="eye"/>
    <geom name="mount" type="box" size=".012 {mount} {mount}" pos="-.0125 0 0" material="mount"/>
    <geom name="backdrop" type="box" size=".9 .9 .002" material="cloth"/>
  </worldbody>
</mujoco>"""


@dataclass(frozen=True)
class Studio:
    """What a photograph shows besides the shape of the body."""

    # uint8 (V, U, 3); columns run along the straight body, rows round its axis from +y to +z
    texture: np.ndarray
    lamps_m: np.ndarray  # (3, 3) places of the lamps; the first two cast shadows
    cloth: np.ndarray  # two RGB colours (2, 3) in [0, 1] of the backdrop
    mount_m: float  # half width of the block that holds the base
    size_m: float  # length of the straight body
    blur_px: float = 0.6  # standard deviation of the lens
    noise: tuple[float, float] = (1.0, 2.5)  # 8-bit levels of the sensor: in the dark, and of a full pixel

    @classmethod
    def random(cls, rng: np.random.Generator, length_m: float, width_m: float) -> "Studio":
        """A studio with a printed body: its colour, its label, the lamps and the cloth."""
        a, b, c = rng.normal(0, 0.15, 3)
        lamps = np.array([[-0.75, -0.75 + a, 0.55], [-0.65, 0.80, -0.55 + b], [0.6, c, 0.9]])
        lamps = np.array([0.45 * length_m, 0, 0]) + 4.5 * length_m * lamps
        grey = rng.uniform(0.62, 0.80)
        cloth = np.stack([np.full(3, grey), np.full(3, grey - 0.03)]) + rng.normal(0, 0.01, 3)
        return cls(printed_texture(rng, length_m), lamps, cloth, 0.7 * width_m, length_m)


def photograph(
    mesh: trimesh.Trimesh | None, rest: np.ndarray, studio: Studio, camera: Camera, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """RGB uint8 (H, W, 3) and mask bool (H, W) of a body, with a backdrop behind it as seen from the camera.

    The mesh, m, is that of the deformed body in the base frame, None for the empty studio; `rest` (V, 3) are
    its vertices when it is straight, which say which part of the texture is where. The camera has square
    pixels, its axis in the middle, and no distortion; `rng` is of the sensor's noise.
    """
    size = camera.width, camera.height
    spec = mujoco.MjSpec.from_string(_studio_xml(studio, FINE * camera.width, FINE * camera.height))
    if mesh is not None:
        _add_body(spec, mesh, rest, studio)
    turn = camera.extrinsics[:3, :3].T
    eye = -turn @ camera.extrinsics[:3, 3]
    seer = spec.camera("eye")
    seer.pos, looks = eye, Rotation.from_matrix(turn @ np.diag([1.0, -1.0, -1.0]))  # MuJoCo's along -z
    seer.quat = looks.as_quat(scalar_first=True)
    seer.fovy = float(np.degrees(2 * np.arctan(0.5 * camera.height / camera.intrinsics[1, 1])))
    wall, forward = spec.geom("backdrop"), turn[:, 2]
    wall.pos = eye + (forward @ -eye + 2.2 * studio.size_m) * forward
    wall.quat = seer.quat
    image, mask = _render(spec.compile())
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(float)
    small = cv2.GaussianBlur(small, (0, 0), studio.blur_px)
    dark, full = studio.noise
    small += rng.normal(size=small.shape) * np.sqrt(dark**2 + full**2 * small / 255)
    share = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.clip(np.round(small), 0, 255).astype(np.uint8), share >= 0.5


def ragged(mask: np.ndarray, size_px: float, rng: np.random.Generator) -> np.ndarray:
    """The mask with an edge that wanders by `size_px`, over some 10 pixels along it."""
    if not size_px:
        return mask
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    wander = cv2.resize(rng.normal(size=[n // 10 for n in mask.shape]), mask.shape[::-1])
    return inside - outside + size_px * wander / wander.std() > 0


def _studio_xml(studio: Studio, width: int, height: int) -> str:
    def words(v):
        return " ".join(f"{x:.5g}" for x in v)

    aim = np.array([0.5 * studio.size_m, 0, 0.1 * studio.size_m])
    lamps = {f"lamp{i + 1}": words(p) for i, p in enumerate(studio.lamps_m)}
    towards = {f"to{i + 1}": words(aim - p) for i, p in enumerate(studio.lamps_m)}
    return _STUDIO.format(
        w=width, h=height, mount=f"{studio.mount_m:.5g}",
        cloth1=words(studio.cloth[0]), cloth2=words(studio.cloth[1]), **lamps, **towards,
    )  # fmt: skip


def _add_body(spec: mujoco.MjSpec, mesh: trimesh.Trimesh, rest: np.ndarray, studio: Studio) -> None:
    """Adds the mesh with one vertex a corner, since the texture has a seam round the axis."""
    corners = mesh.faces.ravel()
    u = rest[corners, 0] / studio.size_m
    v = (np.arctan2(rest[corners, 2], rest[corners, 1]) / (2 * np.pi)).reshape(-1, 3)
    v += np.round(v[:, :1] - v)  # the corners of a face on one side of the seam
    height, width = studio.texture.shape[:2]
    size = {"width": width, "height": height, "nchannel": 3}
    texture = spec.add_texture(name="print", type=mujoco.mjtTexture.mjTEXTURE_2D, **size)
    texture.data = np.ascontiguousarray(studio.texture).tobytes()
    material = spec.add_material(name="print", specular=0.25, shininess=0.25)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "print"
    shape = {"uservert": mesh.vertices[corners], "usernormal": mesh.vertex_normals[corners]}
    shape |= {"usertexcoord": np.stack([u, v.ravel()], 1), "userface": np.arange(len(corners))}
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.add_mesh(name="body", inertia=shell, **{name: values.ravel() for name, values in shape.items()})
    spec.worldbody.add_geom(
        name="body", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="body", material="print", group=BODY
    )


def _render(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Picture (H, W, 3) at the renderer's resolution, and which of its pixels show the body."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    size = model.vis.global_.offwidth, model.vis.global_.offheight
    try:
        renderer = Renderer(model)
    except Exception as e:  # every platform and driver fails in its own way
        raise InputError(
            f"Photographs need OpenGL, which does not start here ({e}); install Mesa's EGL."
        ) from e
    try:
        image, depth = renderer.render_depth(data, *size, (0, BODY), camera="eye")
        behind = renderer.render_depth(data, *size, (0,), camera="eye")[1]
    finally:
        renderer.close()
    return image, depth < behind
