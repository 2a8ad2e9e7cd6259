"""A world as a Gymnasium environment, in the layout that LeRobot expects of a simulator.

`PneutacEnv`, the simulated robot's, is registered as `pneutac_sim/TASK`.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import gymnasium
import numpy as np
from gymnasium import spaces

from pneutac_sim.errors import InputError
from pneutac_sim.features import (
    IMAGE_NAME,
    POINTS_KEY,
    POINTS_SIZE,
    action_limits,
    state_limits,
)
from pneutac_sim.twin import NETWORKS, Twin
from pneutac_sim.world.base import Observation
from pneutac_sim.world.checks import Conditions
from pneutac_sim.world.look import SceneCameras, tactile_points
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World


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

        Raises:
            InputError: as `SceneCameras`, or points without touch.
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


class PneutacEnv(TaskEnv):
    """A task on the simulated robot, see `TaskEnv`."""

    def __init__(
        self,
        task: str = "switch",
        touch: str = "image",
        twin: Twin | str | Path | None = None,
        fidelity: str | None = None,
        conditions: Conditions | None = None,
        render: str = "mesh",
        pressure_range_kpa: tuple[float, float] | None = None,
        station: Station | None = None,
        **options,
    ):
        """An environment with a task.

        Args:
            task: a task's name, see `features.task_names`.
            touch: `image`, `area` or `none`, see `World`.
            twin: the finger, or an arm of several chambers, with its gel, or its folder; default the built-in
                one.
            fidelity: `surrogate`, `mpm` or `probe`, see `World`; all have the same spaces. None for
                `surrogate`, or, with a warning, `probe` where no networks were trained for the twin; an arm
                has `probe` alone.
            conditions: what the twin's effects ask for, such as `{"temperature_c": [20, 30]}`, see `World`.
            render: `mesh` or `splats`, what draws touch and finger, see `World`.
            pressure_range_kpa: of the action; default what the twin was measured over.
            station: workspace and mount; default the paper's.
            options: `render_mode`, `render_width`, `render_height`, `cameras`, `randomise_look`,
                `points` of `TaskEnv`.
        """
        twin = Twin.load(twin) if isinstance(twin, str | Path) else twin or Twin.builtin()
        more = {"pressure_range_kpa": pressure_range_kpa, "station": station}
        world = World(task, twin, touch, fidelity or _best_fidelity(twin), conditions, render, **more)
        super().__init__(world, touch, **options)


def _best_fidelity(twin: Twin) -> str:
    from pneutac_sim.surrogate.finger import builtin, fits  # its modules take a second to start

    if twin.device == "arm":
        return "probe"  # it has no other
    if twin.device != "finger" or twin.networks or all(fits(builtin(name), name, twin) for name in NETWORKS):
        return "surrogate"
    warnings.warn(
        "The twin has no networks of its own, so finger and gel deform by formulas (fidelity `probe`); "
        "`pneutac surrogate` trains networks.",
        stacklevel=3,
    )
    return "probe"
