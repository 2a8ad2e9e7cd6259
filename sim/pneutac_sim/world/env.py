"""The Gymnasium environment around the world, in the layout that LeRobot expects of a simulator."""

import warnings
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium import spaces

from pneutac_sim.features import (
    ACTION_HIGH,
    ACTION_LOW,
    CONTROL_HZ,
    IMAGE_NAME,
    IMAGE_SHAPE,
    STATE_HIGH,
    STATE_LOW,
)
from pneutac_sim.twin import NETWORKS, Twin
from pneutac_sim.world.conditions import Conditions
from pneutac_sim.world.standin import StandinWorld
from pneutac_sim.world.world import Observation, World


class PneutacEnv(gymnasium.Env):
    """A task as a Gymnasium environment; reward 1 on the step that succeeds.

    Observation: `agent_pos` (20,) float32 as `features.STATE_NAMES` and, with `touch="image"`,
    `pixels/tactile` uint8 (320, 240, 3). Action: (4,) float32 as `features.ACTION_NAMES`. An episode
    terminates on success and on failure; `info` has `is_success`, `failure` (text, empty where none),
    `clipped` and `out_of_range`, see `World`.

    Attributes:
        world: the world inside, for experts and tests.
        task: the task's name.
        task_description: the instruction.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}

    def __init__(
        self,
        task: str = "switch",
        touch: str = "image",
        twin: Twin | str | Path | None = None,
        render_mode: str | None = "rgb_array",
        render_width: int = 480,
        render_height: int = 360,
        fidelity: str | None = None,
        world: World | None = None,
        conditions: Conditions | None = None,
        render: str = "mesh",
    ):
        """An environment with a task.

        Args:
            task: `switch`, `egg` or `card`.
            touch: `image`, `area` or `none`, see `World`.
            twin: the finger with its gel, or its folder; default the built-in one.
            render_mode: `rgb_array` or None.
            render_width: pixels of `render()`.
            render_height: pixels of `render()`.
            fidelity: `surrogate`, `mpm` or `probe`, see `World`; all have the same spaces. None for
                `surrogate`, or, with a warning, `probe` where no networks were trained for the twin.
            world: another world of this task and touch, such as a `StandinWorld`, in place of the one that
                `twin`, `fidelity`, `conditions` and `render` describe.
            conditions: what the twin's effects ask for, such as `{"temperature_c": [20, 30]}`, see `World`.
            render: `mesh` or `splats`, what draws touch and finger, see `World`.
        """
        if world is None:
            twin = Twin.load(twin) if isinstance(twin, str | Path) else twin or Twin.builtin()
            world = World(task, twin, touch, fidelity or _best_fidelity(twin), conditions, render)
        self.world, self._begun = world, False
        self.task = task
        self.task_description = self.world.task.description
        self.render_mode = render_mode
        self._render_size = (render_width, render_height)
        self.action_space = spaces.Box(ACTION_LOW, ACTION_HIGH, dtype=np.float32)
        observation = {"agent_pos": spaces.Box(STATE_LOW, STATE_HIGH, dtype=np.float32)}
        if touch == "image":
            image = spaces.Box(0, 255, IMAGE_SHAPE, np.uint8)
            observation = {"pixels": spaces.Dict({IMAGE_NAME: image}), **observation}
        self.observation_space = spaces.Dict(observation)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Starts an episode; a seed means the same as in `World.reset`.

        Without one the start is random and the session goes on; the first begins one.
        """
        super().reset(seed=seed)
        if seed is None and not self._begun:
            seed = int(self.np_random.integers(2**31))
        self._begun = True
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
        """Frees the renderer."""
        self.world.close()

    def _observation(self, o: Observation) -> dict:
        if o.tactile is None:
            return {"agent_pos": o.state}
        return {"pixels": {IMAGE_NAME: o.tactile}, "agent_pos": o.state}

    def _info(self) -> dict:
        return {
            "is_success": self.world.success,
            "failure": self.world.failure or "",
            "clipped": self.world.clipped,
            "out_of_range": self.world.out_of_range,
        }


def _best_fidelity(twin: Twin) -> str:
    from pneutac_sim.surrogate.networks import builtin, fits  # its modules take a second to start

    if twin.device != "finger" or twin.networks or all(fits(builtin(name), name, twin) for name in NETWORKS):
        return "surrogate"
    warnings.warn(
        "The twin has no networks of its own, so finger and gel deform by formulas (fidelity `probe`); "
        "`pneutac surrogate` trains networks.",
        stacklevel=3,
    )
    return "probe"


def standin_env(task: str = "switch", touch: str = "image", gel: str = "layer", **options) -> PneutacEnv:
    """A task on the stand-in for reality; arguments of `StandinWorld`, `options` of `PneutacEnv`."""
    return PneutacEnv(task, touch, world=StandinWorld(task, touch, gel), **options)
