"""A flat-shaded drawing of the scene without OpenGL: each geom as the filled hull of its projected points."""

import cv2
import mujoco
import numpy as np

from pneutac_sim.world.scene import SEEN_GROUPS

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_ANGLES = np.linspace(0, 2 * np.pi, 13)[:-1]
_RING = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(12)], 1)
_BALL = np.concatenate([_RING * np.cos(t) + [0, 0, np.sin(t)] for t in np.linspace(-1.5, 1.5, 7)])
_SKY, _TABLE = (214, 222, 232), (204, 197, 185)


def draw(model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int) -> np.ndarray:
    """Drawing uint8 (height, width, 3) of the visible geoms from a fixed camera, farthest first."""
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
        shapes.append((local[:, 2].mean(), pixels.round().astype(np.int32), _colour(model, g)))
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
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.concatenate([_RING * size[0] + [0, 0, z] for z in (-size[1], size[1])])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.concatenate([_BALL * size[0] + [0, 0, z] for z in (-size[1], size[1])])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return _BALL * size[0]
    return _BALL * size


def _colour(model: mujoco.MjModel, g: int) -> tuple[int, int, int]:
    material = model.geom_matid[g]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[g]
    return tuple(int(235 * c) for c in rgba[:3])
