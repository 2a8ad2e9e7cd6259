"""A photo studio for bodies: a textured mesh between lamps, photographed by MuJoCo's renderer.

Nothing in it is shared with the splats that a twin draws itself with, so that a fit to these pictures meets
lights, shadows, highlights, textures and sensor noise that it has no words for.

The texture of a rubber body from a printer, with a touch sensor at its tip.
"""

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.solid import PITCH_M
from pneutac_sim.splat.camera import Camera
from pneutac_sim.world.view import gl_context


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
        turn = rng.normal(0, 0.15, 3)
        middle = np.array([0.45 * length_m, 0, 0])
        far = 4.5 * length_m
        lamps = [
            middle + far * np.array([-0.75, -0.75 + turn[0], 0.55]),
            middle + far * np.array([-0.65, 0.80, -0.55 + turn[1]]),
            middle + far * np.array([0.6, turn[2], 0.9]),
        ]
        grey = rng.uniform(0.62, 0.80)
        cloth = np.stack([np.full(3, grey), np.full(3, grey - 0.03)]) + rng.normal(0, 0.01, 3)
        return cls(printed_texture(rng, length_m), np.array(lamps), cloth, 0.7 * width_m, length_m)


def photograph(
    mesh: trimesh.Trimesh | None, rest: np.ndarray, studio: Studio, camera: Camera, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Photographs a body, with a backdrop behind it as seen from the camera.

    Args:
        mesh: of the deformed body, m, in the base frame; None for the empty studio.
        rest: (V, 3) its vertices when it is straight; they say which part of the texture is where.
        studio: lamps and texture.
        camera: in the base frame, with square pixels, its axis in the middle, and no distortion.
        rng: of the sensor's noise.

    Returns:
        RGB uint8 (H, W, 3) and mask bool (H, W) of the body.
    """
    size = camera.width, camera.height
    spec = mujoco.MjSpec.from_string(_studio_xml(studio, FINE * camera.width, FINE * camera.height))
    if mesh is not None:
        _add_body(spec, mesh, rest, studio)
    turn = camera.extrinsics[:3, :3].T
    eye = -turn @ camera.extrinsics[:3, 3]
    seer = spec.camera("eye")
    seer.pos, seer.quat = eye, _quaternion(turn @ np.diag([1.0, -1.0, -1.0]))  # MuJoCo looks along -z
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
    texture = spec.add_texture(
        name="print", type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
    )
    texture.data = np.ascontiguousarray(studio.texture).tobytes()
    material = spec.add_material(name="print", specular=0.25, shininess=0.25)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "print"
    spec.add_mesh(
        name="body",
        uservert=mesh.vertices[corners].ravel(),
        usernormal=mesh.vertex_normals[corners].ravel(),
        usertexcoord=np.stack([u, v.ravel()], 1).ravel(),
        userface=np.arange(len(corners)),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(name="body", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="body", material="print")


def _render(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Picture (H, W, 3) at the renderer's resolution, and which of its pixels show the body."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    w, h = model.vis.global_.offwidth, model.vis.global_.offheight
    try:
        context = gl_context(model)
    except Exception as e:  # every platform and driver fails in its own way
        raise InputError(
            f"Photographs need OpenGL, which does not start here ({e}); install Mesa's EGL."
        ) from e
    mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    try:
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, mjr)
        scene, camera = mujoco.MjvScene(model, maxgeom=20), mujoco.MjvCamera()
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera("eye").id
        mujoco.mjv_updateScene(
            model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene
        )
        image, ids = np.empty((h, w, 3), np.uint8), np.empty((h, w, 3), np.uint8)
        rect = mujoco.MjrRect(0, 0, w, h)
        mujoco.mjr_render(rect, scene, mjr)
        mujoco.mjr_readPixels(image, None, rect, mjr)
        scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = True
        scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        mujoco.mjr_render(rect, scene, mjr)
        mujoco.mjr_readPixels(ids, None, rect, mjr)
    finally:
        mjr.free()
        context.free()
    names = [model.geom(g).name for g in range(model.ngeom)]
    body = [g.segid + 1 for g in scene.geoms[: scene.ngeom] if names[g.objid] == "body"]
    return image[::-1], np.isin(ids[::-1, :, 0], body)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    out = np.empty(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(rotation).ravel())
    return out
