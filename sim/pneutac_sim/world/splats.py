"""The finger of a world by its twin's own splats, over MuJoCo's picture of everything else."""

from dataclasses import replace
from typing import override

import mujoco
import numpy as np
from scipy.spatial import cKDTree

from pneutac_sim.splat.body import ARRAYS, blank_looks, looks_from_twin, strain, stretch_colours
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.render import Gaussians, on
from pneutac_sim.twin import Twin
from pneutac_sim.world.scene import SEEN_GROUPS
from pneutac_sim.world.view import CAMERA, View

CAP_M = 5e-3  # of the stiff end, as the material points have it
SKIN_GROUP = 4  # of the geoms that splats stand in for
DETAIL = 2  # Gaussians along the edge of a particle, where no photograph says more
# Light on a finger that has no photograph's: from the scene's lamp, above and before it.
AMBIENT, DIFFUSE, TO_LIGHT = 0.75, 0.4, np.array([0.4, -0.6, 0.7])
LEAST = 1e-3  # coverage of a pixel that has a depth
EDGE_M = 1e-3  # over which splats go in front of what they touch
DEVICE = "auto"  # that draws a world's splats
NEARER_M = 1e-4  # by which a pixel of the skin is nearer than what is behind it


class SplatView(View):
    """As `View`, with splats in place of the finger's geoms.

    MuJoCo draws the scene without the finger, for colours and depth, and with it, for the shadow that it
    casts; splats are put in front of what is farther away than they are.
    """

    def __init__(self, model: mujoco.MjModel, twin: Twin):
        super().__init__(model, required=True)
        self._finger = SplatFinger(model, twin, DEVICE)
        skin = np.isin(model.geom_bodyid, self._finger.links[:-1]) & np.isin(model.geom_group, SEEN_GROUPS)
        model.geom_group[skin] = SKIN_GROUP

    @override
    def scene(self, data: mujoco.MjData, camera: str, width: int, height: int) -> np.ndarray:
        self._start()
        assert self._gl is not None
        size = (data, width, height)
        bare, behind = self._gl.render_depth(*size, SEEN_GROUPS, shadows=False, camera=camera)
        whole, nearest = self._gl.render_depth(*size, (*SEEN_GROUPS, SKIN_GROUP), camera=camera)
        scene = np.where((nearest < behind - NEARER_M)[..., None], bare, whole)
        at = camera_of(self._model, *size, camera)
        image, alpha, depth = self._finger.picture(data, at)
        share = alpha * ((behind - depth) / EDGE_M + 0.5).clip(0, 1)
        front = image / np.maximum(alpha, 1e-6)[..., None]
        mixed = share[..., None] * 255 * front + (1 - share)[..., None] * scene
        return mixed.clip(0, 255).round().astype(np.uint8)


class SplatFinger:
    """Gaussians of a finger that follow the bodies of a model.

    A link is where MuJoCo has it, half way between its joints; from there to the middle of the next the poses
    are blended linearly, so that each hinge bends the finger over its own segment. The twin has looks from
    photographs, else it is coloured by stretch and lit.

    Attributes:
        links: (N + 2,) ids of base, links and sensor.
    """

    def __init__(self, model: mujoco.MjModel, twin: Twin, device: str = "cpu"):
        self._on = on(device)
        joints, length = 1e-3 * np.asarray(twin.spine_joint_positions_mm), 1e-3 * twin.length_mm
        names = ["finger", *(f"spine_{n + 1}" for n in range(len(joints))), "sensor"]
        self.links = np.array([model.body(name).id for name in names])
        self._origins = np.concatenate([[0.0], joints, [length]])
        self._looks, self._normals = _looks(twin)
        end = max(joints[-1], length - CAP_M), length
        middles = np.concatenate([[0.0], (joints[:-1] + joints[1:]) / 2, end])
        x = self._looks.means[:, 0].astype(float)
        place = np.interp(x, middles, np.arange(len(middles)))
        self._low = np.minimum(place.astype(int), len(middles) - 2)
        self._share = place - self._low
        inside = (x > 0) & (x < length)
        self._slope = np.where(inside, 1 / np.diff(middles)[self._low], 0.0)  # of the share, 1/m

    def at(self, data: mujoco.MjData) -> Gaussians:
        """Gaussians in the world where MuJoCo has the finger; `data` must have its kinematics up to date."""
        R = data.xmat[self.links].reshape(-1, 3, 3)
        t = data.xpos[self.links] - self._origins[:, None] * R[:, :, 0]
        X = self._looks.means.astype(float)
        low, high, w = self._low, self._low + 1, self._share
        near, far = (np.einsum("nij,nj->ni", R[k], X) + t[k] for k in (low, high))
        # x = (1 - w) x_low + w x_high, F = dx/dX
        x = near + w[:, None] * (far - near)
        F = R[low] + w[:, None, None] * (R[high] - R[low])
        F[:, :, 0] += self._slope[:, None] * (far - near)
        now = self._looks.moved(x, F)
        if self._normals is None:
            return now
        light = AMBIENT + DIFFUSE * np.einsum("nij,nj->ni", now.rotations, self._normals) @ TO_LIGHT
        return replace(now, colours=(light[:, None] * stretch_colours(strain(F)) / 255).clip(0, 1))

    def picture(self, data: mujoco.MjData, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image (H, W, 3), 0 to 1 on black, coverage (H, W) and mean depth (H, W) in m, inf outside it."""
        now = self.at(data)
        depth = camera.project(now.means)[1]
        splats = self._on(camera, now.means, now.covariances(), now.opacities)
        seen, deep = splats.render(now.colours), splats.render(np.repeat(depth[:, None], 3, 1))
        alpha = seen.alpha.astype(float)
        mean = deep.image[..., 0] / np.maximum(alpha, LEAST)
        return seen.image, alpha, np.where(alpha > LEAST, mean, np.inf)


def _looks(twin: Twin) -> tuple[Gaussians, np.ndarray | None]:
    """Gaussians of the straight finger; without a photograph's colours also their outward normals (n, 3)."""
    if all(array in twin.arrays for array in ARRAYS):
        return looks_from_twin(twin), None
    from pneutac_sim.mpm.solid import bending_body

    body = bending_body(twin)
    looks = blank_looks(body, DETAIL)
    tree = cKDTree(body.positions)
    near = tree.query_ball_point(looks.means, 2.5 * body.spacing_m)
    away = np.array([x - body.positions[k].mean(0) for x, k in zip(looks.means, near, strict=True)])
    return looks, away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 0.3 * body.spacing_m)


def camera_of(
    model: mujoco.MjModel, data: mujoco.MjData, width: int, height: int, name: str = CAMERA
) -> Camera:
    """MuJoCo's camera as the rasteriser takes it; MuJoCo's looks along -z with y upwards."""
    cam = model.camera(name)
    axes = data.cam_xmat[cam.id].reshape(3, 3) * [1, -1, -1]  # right, down, forwards
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = axes.T, -axes.T @ data.cam_xpos[cam.id]
    focal = height / 2 / np.tan(np.radians(cam.fovy[0]) / 2)
    return Camera(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), view, width, height)
