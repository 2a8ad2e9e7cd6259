"""Pictures of the world: by MuJoCo's renderer, or drawn from the kinematics where there is no OpenGL."""

import logging
import os
import sys
from collections.abc import Collection

import cv2
import mujoco
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.world.scene import SEEN_GROUPS

logger = logging.getLogger(__name__)

CAMERA = "close"
INSET = 0.36  # height of the tactile image as a share of the picture's
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_ANGLES = np.linspace(0, 2 * np.pi, 13)[:-1]
_RING = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(12)], 1)
_BALL = np.concatenate([_RING * np.cos(t) + [0, 0, np.sin(t)] for t in np.linspace(-1.5, 1.5, 7)])
_SKY, _TABLE = (214, 222, 232), (204, 197, 185)


class View:
    """A camera on a model, with the tactile image inset. OpenGL starts with the first picture.

    Where it does not, pictures are drawn from the kinematics, or InputError is raised if it is `required`.
    """

    def __init__(self, model: mujoco.MjModel, required: bool = False):
        self._model, self._required = model, required
        self._gl = None
        self._failed = False

    @property
    def uses_gl(self) -> bool:
        return self._gl is not None

    def picture(self, data: mujoco.MjData, tactile: np.ndarray | None, width: int, height: int) -> np.ndarray:
        """Picture uint8 (height, width, 3) of the state; `data` must have its kinematics up to date."""
        image = self.scene(data, CAMERA, width, height)
        if tactile is not None:
            _inset(image, tactile)
        return image

    def scene(self, data: mujoco.MjData, camera: str, width: int, height: int) -> np.ndarray:
        """Picture uint8 (height, width, 3) from a camera of the model, without the inset."""
        self._start()
        if self._gl is not None:
            return self._gl.render_depth(data, width, height, SEEN_GROUPS, camera=camera)[0]
        return draw(self._model, data, camera, width, height)

    def _start(self) -> None:
        if self._gl is None and not self._failed:
            try:
                self._gl = Renderer(self._model)
            except Exception as e:  # every platform and driver fails in its own way
                if self._required:
                    raise no_gl(e) from e
                logger.warning("No OpenGL (%s): pictures are drawn from the kinematics instead.", e)
                self._failed = True

    def upload_texture(self, name: str) -> None:
        """Takes a texture of the model that was changed."""
        self._start()
        if self._gl is not None:
            self._gl.upload_texture(name)

    def close(self) -> None:
        """Frees the renderer; a later picture starts it again."""
        if self._gl is not None:
            self._gl.close()
            self._gl = None


def gl_context(model: mujoco.MjModel):
    """A current GL context of the model's offscreen size, freed by its owner; EGL without a display.

    `mujoco.Renderer` takes its backend from MUJOCO_GL when mujoco is imported, which is too early for a
    library; this decides at the first picture and sets no variable unless the backend itself does. Every
    platform and driver fails in its own way.
    """
    if sys.platform == "linux" and not os.environ.get("MUJOCO_GL") and not os.environ.get("DISPLAY"):
        from mujoco.egl import GLContext
    else:
        from mujoco.gl_context import GLContext
    context = GLContext(model.vis.global_.offwidth, model.vis.global_.offheight)
    context.make_current()
    return context


def require_gl() -> None:
    """Raises InputError where no OpenGL starts for splats and scene cameras."""
    try:
        gl_context(mujoco.MjModel.from_xml_string("<mujoco/>")).free()
    except Exception as e:  # every platform and driver fails in its own way
        raise no_gl(e) from e


def no_gl(reason: Exception) -> InputError:
    """What to do where splats or scene cameras find no OpenGL."""
    return InputError(
        f"Splats and scene cameras are drawn with MuJoCo's picture, which needs OpenGL, and none starts"
        f" ({reason}); install one, on Debian and Ubuntu by `apt install libegl1 libgl1-mesa-dri`, or choose"
        " render=mesh and no scene cameras."
    )


class Renderer:
    """MuJoCo's renderer on a GL context of its own."""

    def __init__(self, model: mujoco.MjModel):
        self._context = gl_context(model)
        self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self._model = model
        self._scene = mujoco.MjvScene(model, maxgeom=500)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._option = mujoco.MjvOption()
        # A perspective of far planes: readPixels gives 1 at the near plane and 0 at the far one.
        self._mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value

    def upload_texture(self, name: str) -> None:
        """Uploads a texture of the model to the renderer again."""
        self._context.make_current()
        mujoco.mjr_uploadTexture(self._model, self._mjr, self._model.texture(name).id)

    def render_depth(
        self,
        data: mujoco.MjData,
        width: int,
        height: int,
        groups: Collection[int],
        shadows: bool = True,
        camera: str = CAMERA,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The geoms of some groups: image uint8 (height, width, 3) and depth (height, width) in m."""
        self._camera.fixedcamid = self._model.camera(camera).id
        self._option.geomgroup[:] = [g in groups for g in range(mujoco.mjNGROUP)]
        self._context.make_current()
        # The headlight is where the camera is before the update, which would be that of the last picture.
        mujoco.mjv_updateCamera(self._model, data, self._camera, self._scene)
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW.value] = shadows
        image, nearness = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, self._scene, self._mjr)
        mujoco.mjr_readPixels(image, nearness, rect, self._mjr)
        near, far = np.multiply(
            self._model.stat.extent, (self._model.vis.map.znear, self._model.vis.map.zfar)
        )
        depth = near * far / (near + nearness[::-1].astype(float) * (far - near))
        return np.ascontiguousarray(image[::-1]), depth

    def close(self) -> None:
        self._context.make_current()
        self._mjr.free()
        self._context.free()


def _inset(image: np.ndarray, tactile: np.ndarray) -> None:
    height, width = image.shape[:2]
    rows = int(INSET * height)
    cols = rows * tactile.shape[1] // tactile.shape[0]
    y, x = height - rows - 8, width - cols - 8
    if y < 2 or x < 2:
        return
    i = (np.arange(rows) + 0.5) * tactile.shape[0] / rows
    j = (np.arange(cols) + 0.5) * tactile.shape[1] / cols
    image[y - 2 : y + rows + 2, x - 2 : x + cols + 2] = 245
    image[y : y + rows, x : x + cols] = tactile[i.astype(int)[:, None], j.astype(int)]


def draw(model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int) -> np.ndarray:
    """Drawing without OpenGL, uint8 (height, width, 3): each geom is the filled hull of its projected points.

    From a fixed camera, the farthest geom first.
    """
    cam = model.camera(camera)
    position, axes = data.cam_xpos[cam.id], data.cam_xmat[cam.id].reshape(3, 3)
    focal = height / 2 / np.tan(np.radians(cam.fovy[0]) / 2)
    image = np.empty((height, width, 3), np.uint8)
    forward = -axes[:, 2]
    horizon = int(height / 2 + focal * forward[2] / np.hypot(forward[0], forward[1]))
    image[: max(horizon, 0)] = _SKY
    image[max(horizon, 0) :] = _TABLE

    shapes = []
    for g in range(model.ngeom):
        if model.geom_group[g] not in SEEN_GROUPS or model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        world = data.geom_xpos[g] + _outline(model, g) @ data.geom_xmat[g].reshape(3, 3).T
        local = (world - position) @ axes  # x right, y up, z backwards
        if local[:, 2].max() > -0.02:
            continue
        pixels = focal * local[:, :2] / -local[:, 2:] * [1, -1] + [width / 2, height / 2]
        material = model.geom_matid[g]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[g]
        colour = tuple(int(235 * c) for c in rgba[:3])
        shapes.append((local[:, 2].mean(), pixels.round().astype(np.int32), colour))
    for _, pixels, colour in sorted(shapes, key=lambda s: s[0]):
        hull = cv2.convexHull(pixels)
        cv2.fillConvexPoly(image, hull, colour, cv2.LINE_AA)
        cv2.polylines(image, [hull], True, tuple(int(0.7 * c) for c in colour), 1, cv2.LINE_AA)
    return image


def _outline(model: mujoco.MjModel, g: int) -> np.ndarray:
    """Points (n, 3) whose convex hull is the geom, in its own frame, metres."""
    kind, size = model.geom_type[g], model.geom_size[g]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _CORNERS * size
    if kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        end = _RING if kind == mujoco.mjtGeom.mjGEOM_CYLINDER else _BALL
        return np.concatenate([end * size[0] + [0, 0, z] for z in (-size[1], size[1])])
    return _BALL * (size[0] if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size)
