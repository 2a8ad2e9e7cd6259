"""Pictures of a world from the cameras around its robot, and looks of its scene drawn at random.

Touch as data: displacement and force on a grid of points of the gel's face, in addition to the image.

The layout `[dx, dy, dz, Fx, Fy, Fz]` of each point is the one that LeRobot's own tactile module proposes
(huggingface/lerobot, pull requests 3175 and 4469, undecided). Frame: that of the gel, x along the image's
columns, y along its rows (downwards), z out of the sensor towards the object.
"""

from collections.abc import Mapping

import cv2
import mujoco
import numpy as np

from pneutac_sim.features import POINTS_SHAPE
from pneutac_sim.world.base import pad_contacts
from pneutac_sim.world.scene import check_camera
from pneutac_sim.world.view import require_gl

TABLE = "table"  # texture
SHADE = (0.6, 1.4)  # factors on each lamp, on the light from all around and on each colour
LAMP_M = 0.15  # by which the lamps are moved, at most, along each axis
TINT = 0.12  # by which red, green and blue of a colour differ
GRAIN = (2, 24)  # spots along the edge of the table's texture


class SceneCameras:
    """Pictures of a world from the cameras around its robot.

    `sizes` is each camera's name, of `SCENE_CAMERAS`, to height and width of its picture in px. With
    `randomise_look` light, colours and the table's texture are newly drawn in every episode.

    Raises:
        InputError: there is no such camera, no such size, or no OpenGL.
    """

    def __init__(self, world, sizes: Mapping[str, tuple[int, int]], randomise_look: bool = False):
        for name, size in sizes.items():
            check_camera(name, size)
        if sizes:
            require_gl()
        self._world, self._sizes = world, dict(sizes)
        self._look = Look(world.model) if randomise_look else None
        self._rng = np.random.default_rng()

    def begin(self, seed: int | None) -> None:
        """An episode begins; the seed decides the look, None goes on in the same stream."""
        if self._look is None:
            return
        if seed is not None:
            self._rng = np.random.default_rng([seed, 3])
        self._look.draw(self._rng)
        self._world.view.upload_texture(TABLE)

    def pictures(self) -> dict[str, np.ndarray]:
        """Each camera's picture of the present state, uint8 (H, W, 3)."""
        if not self._sizes:
            return {}
        model, data, view = self._world.model, self._world.data, self._world.view
        mujoco.mj_camlight(model, data)
        return {n: view.scene(data, n, width, height) for n, (height, width) in self._sizes.items()}


class Look:
    """Light, colours and the table's texture of a model, drawn at random about what they were."""

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        head = model.vis.headlight
        self._whole = model.light_diffuse, model.mat_rgba[:, :3], head.diffuse, head.ambient
        self._base = [a.copy() for a in self._whole]
        self._lamps_m = model.light_pos.copy()
        texture = model.texture(TABLE).id
        start = int(model.tex_adr[texture])
        self._shape = (int(model.tex_height[texture]), int(model.tex_width[texture]), 3)
        self._texels = model.tex_data[start : start + int(np.prod(self._shape))]
        self._table = self._texels.astype(float).reshape(-1, 3).mean(0)

    def draw(self, rng: np.random.Generator) -> None:
        for values, base in zip(self._whole, self._base, strict=True):
            values[:] = (base * _shades(rng, base.shape)).clip(0, 1)
        self._model.light_pos[:] = self._lamps_m + LAMP_M * rng.uniform(-1, 1, self._lamps_m.shape)
        first, second = (self._table * _shades(rng, (3,)) for _ in range(2))
        spots = rng.random((int(rng.integers(*GRAIN)),) * 2)
        share = cv2.resize(spots, self._shape[1::-1], interpolation=cv2.INTER_CUBIC)[..., None]
        self._texels[:] = (first + share * (second - first)).clip(0, 255).round().astype(np.uint8).ravel()


def _shades(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Factors on colours of a shape (..., 3): one brightness each, and a tint."""
    return rng.uniform(*SHADE, (*shape[:-1], 1)) * rng.uniform(1 - TINT, 1 + TINT, shape)


POINT_NAMES = ("dx", "dy", "dz", "Fx", "Fy", "Fz")


def points_info(window_mm: tuple[float, float]) -> dict:
    """What a dataset says of them: layout, units, frame, and width and height of the window in mm."""
    return {
        "shape": list(POINTS_SHAPE),
        "axes": ["row", "column", "value"],
        "values": list(POINT_NAMES),
        "units": ["mm", "mm", "mm", "N", "N", "N"],
        "frame": "gel: x along image columns, y along image rows, z out of the sensor; force on the gel",
        "window_mm": list(window_mm),
        "shear": "dx and dy are 0: the gel's model has no shear",
    }


def tactile_points(world) -> np.ndarray:
    """The face of a world's gel now, float32 `POINTS_SHAPE`: displacement in mm and force on the gel in N.

    dz is the mean over a point's cell, below 0 where the face is pressed in. The contact force of the last
    physics step is shared among the points as their imprints are, so that they sum to it; outside the window
    there are no points. An image's lag is not in them.
    """
    inwards = world.touch.displacement_mm.astype(np.float32)
    rows, columns, _ = POINTS_SHAPE
    cells = cv2.resize(inwards, (columns, rows), interpolation=cv2.INTER_AREA)
    points = np.zeros(POINTS_SHAPE, np.float32)
    points[..., 2] = -cells
    pressed = cells.clip(0)
    if pressed.any():
        share = pressed / pressed.sum()
        points[..., 3:] = share[..., None] * contact_force_n(world.model, world.data)
    return points


def contact_force_n(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Force (3,) on the gel's pad, N, in the gel's frame; z below 0 presses it in."""
    pad, total = model.geom("pad").id, np.zeros(3)
    for contact, force in pad_contacts(model, data):
        on_second = contact.frame.reshape(3, 3).T @ force[:3]  # MuJoCo's axes point to the second geom
        total += on_second if contact.geom2 == pad else -on_second
    return data.site("gel").xmat.reshape(3, 3).T @ total
