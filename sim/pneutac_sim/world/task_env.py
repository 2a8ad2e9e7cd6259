"""A world as a Gymnasium environment, in the layout that LeRobot expects of a simulator.

Pictures of a world from the cameras around its robot, and looks of its scene drawn at random.

Touch as data: displacement and force on a grid of points of the gel's face, in addition to the image.

The layout `[dx, dy, dz, Fx, Fy, Fz]` of each point is the one that LeRobot's own tactile module proposes
(huggingface/lerobot, pull requests 3175 and 4469, undecided). Frame: that of the gel, x along the image's
columns, y along its rows (downwards), z out of the sensor towards the object.
"""

from collections.abc import Mapping
from types import MappingProxyType

import cv2
import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces

from pneutac_sim.errors import InputError
from pneutac_sim.features import (
    IMAGE_NAME,
    POINTS_KEY,
    POINTS_SHAPE,
    POINTS_SIZE,
    action_limits,
    state_limits,
)
from pneutac_sim.world.base import Observation, pad_contacts
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

    Raises InputError: there is no such camera, no such size, or no OpenGL.
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


class TaskEnv(gymnasium.Env):
    """The task of a world as a Gymnasium environment; reward 1 on the step that succeeds.

    Observation: `agent_pos` float32 as `features.state_names`, (20,) with the Panda and one chamber, and,
    where the world has an image, `pixels/tactile` uint8 (H, W, 3) of the sensor's size, (320, 240, 3) with a
    DIGIT; of each scene camera `pixels/NAME`; where asked for, `tactile.points` (`features.POINTS_SIZE`,).
    Action: (3 + C,) float32 as `features.action_names` of C chambers. An episode terminates on success and on
    failure; `info` has `is_success`, `failure` (text, empty where none), `clipped` and `out_of_range`, see
    `World`.

    Attributes:
        world: the world inside, for experts and tests.
        task: the task's name.
        task_description: the instruction.
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(
        self,
        world,
        touch: str = "image",
        render_mode: str | None = "rgb_array",
        render_width: int = 480,
        render_height: int = 360,
        cameras: Mapping[str, tuple[int, int]] = MappingProxyType({}),
        randomise_look: bool = False,
        points: bool = False,
        start_width: float = 0.0,
    ):
        """An environment of a `World`, or of another with its methods, and with its mode of touch.

        Args:
            world: the world.
            touch: as the world's.
            render_mode: `rgb_array` or None.
            render_width: pixels of `render()`.
            render_height: pixels of `render()`.
            cameras: scene cameras to height and width of their pictures, such as {"front": (240, 320)}.
            randomise_look: draws light, colours and texture of the scene again in every episode.
            points: puts touch as data, `tactile.points`, into the observation.
            start_width: see `BaseWorld.widen_starts`.

        Raises InputError: as `SceneCameras`, or points without touch.
        """
        self.world, self._begun = world, False
        world.widen_starts(start_width)
        self.metadata = self.metadata | {"render_fps": world.station.control_hz}
        self.task, self.task_description = world.task.name, world.task.description
        self.render_mode = render_mode
        self._render_size = (render_width, render_height)
        kpa, chambers, arm = world.pressure_range_kpa, world.chambers, world.arm
        self.action_space = spaces.Box(*action_limits(kpa, chambers), dtype=np.float32)
        rows, columns, _ = world.tactile_shape
        joints = (arm.low_rad, arm.high_rad, arm.speed_rad_s)
        limits = state_limits(kpa, joints, rows * columns, chambers)
        state = spaces.Box(*limits, dtype=np.float32)
        self._cameras = SceneCameras(world, cameras, randomise_look)
        shapes = {IMAGE_NAME: world.tactile_shape} if touch == "image" else {}
        shapes |= {name: (*size, 3) for name, size in cameras.items()}
        pixels = {name: spaces.Box(0, 255, shape, np.uint8) for name, shape in shapes.items()}
        observation = {"pixels": spaces.Dict(pixels)} if pixels else {}
        observation |= {"agent_pos": state}
        self._points = points
        if points:
            if touch == "none":
                raise InputError("There are no tactile points with touch 'none'; choose image or area.")
            observation[POINTS_KEY] = spaces.Box(-np.inf, np.inf, (POINTS_SIZE,), np.float32)
        self.observation_space = spaces.Dict(observation)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Starts an episode; a seed means the same as in `World.reset`.

        Without one the start is random and the session goes on; the first begins one.
        """
        super().reset(seed=seed)
        if seed is None and not self._begun:
            seed = int(self.np_random.integers(2**31))
        self._begun = True
        self._cameras.begin(seed)
        return self._observation(self.world.reset(seed)), self._info()

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """One control step. Raises InputError where the action has another shape or is not finite."""
        observation = self._observation(self.world.step(action))
        info = self._info()
        terminated = bool(info["is_success"] or info["failure"])
        return observation, float(info["is_success"]), terminated, False, info

    def render(self) -> np.ndarray | None:
        """Picture of the scene, uint8 (H, W, 3)."""
        return self.world.render(*self._render_size) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self.world.close()

    def _observation(self, o: Observation) -> dict:
        touch = {} if o.tactile is None else {IMAGE_NAME: o.tactile}
        pixels = touch | self._cameras.pictures()
        touch = {POINTS_KEY: tactile_points(self.world).ravel()} if self._points else {}
        return ({"pixels": pixels} if pixels else {}) | {"agent_pos": o.state} | touch

    def _info(self) -> dict:
        return {
            "is_success": self.world.success,
            "failure": self.world.failure or "",
            "clipped": self.world.clipped,
            "out_of_range": self.world.out_of_range,
        }
