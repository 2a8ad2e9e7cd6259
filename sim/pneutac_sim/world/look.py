"""Pictures of a world from the cameras around its robot, and looks of its scene drawn at random."""

from collections.abc import Mapping

import cv2
import mujoco
import numpy as np

from pneutac_sim.world.cameras import check_camera
from pneutac_sim.world.view import require_gl

TABLE = "table"  # texture
SHADE = (0.6, 1.4)  # factors on each lamp, on the light from all around and on each colour
LAMP_M = 0.15  # by which the lamps are moved, at most, along each axis
TINT = 0.12  # by which red, green and blue of a colour differ
GRAIN = (2, 24)  # spots along the edge of the table's texture


class SceneCameras:
    """Pictures of a world from the cameras around its robot.

    Args:
        world: a `World`, or another with `model`, `data` and `view`.
        sizes: name of each camera, of `SCENE_CAMERAS`, to height and width of its picture in px.
        randomise_look: light, colours and the table's texture are newly drawn in every episode.

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
