"""Many worlds as a Gymnasium vector environment, `gymnasium.make_vec("pneutac_sim/switch", num_envs=N)`."""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from pneutac_sim.errors import InputError
from pneutac_sim.features import CONTROL_HZ, TRIAL_S
from pneutac_sim.world.batch import BatchedWorld


class BatchedEnv(gymnasium.vector.VectorEnv):
    """N worlds of one task that step together, see `BatchedWorld`; reward 1 on the step that succeeds.

    Observation: `BatchedWorld.state` (N, 8 + C) float32. Action: (N, 3 + C) float32. A world terminates on
    success and on failure, and is truncated after `max_episode_steps`. In the step after that its action is
    ignored and it begins again at one of the starts of the last reset (`AutoresetMode.NEXT_STEP`). `info` has
    `is_success` and `is_failure` (N,).

    Attributes:
        world: the worlds inside.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}

    def __init__(
        self,
        num_envs: int = 64,
        task: str = "switch",
        torch_tensors: bool = False,
        max_episode_steps: int = TRIAL_S * CONTROL_HZ,
        starts: int | None = None,
        **options: Any,
    ):
        """Worlds of a task.

        Args:
            num_envs: N.
            task: `switch`, `egg` or `card`.
            torch_tensors: whether actions, observations, rewards and flags are tensors on the device, without
                a copy to the host; NumPy arrays otherwise.
            max_episode_steps: control steps after which a world is truncated.
            starts: drawn at a reset, see `BatchedWorld.reset`.
            options: of `BatchedWorld`, such as `device`, `twin` and `fidelity`.

        Raises InputError: as `BatchedWorld`, or no steps.
        """
        if max_episode_steps < 1:
            raise InputError(f"max_episode_steps is {max_episode_steps}; it must be 1 or more.")
        self.world = w = BatchedWorld(task, num_envs, **options)
        self.num_envs, self._torch = num_envs, torch_tensors
        self._most, self._starts = max_episode_steps, starts
        self.metadata = self.metadata | {"render_fps": w.single.station.control_hz}
        low, high = (limit.cpu().numpy() for limit in w.action_limits)
        self.single_action_space = spaces.Box(low, high, dtype=np.float32)
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (w.state.shape[1],), np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Any, dict]:
        """Starts all worlds; world i of a seed starts as `Gantry.reset(seed + i)`."""
        super().reset(seed=seed)
        seed = int(self.np_random.integers(2**31)) if seed is None else seed
        self.world.reset(seed, self._starts)
        self._count = len(self.world._starts["area"])
        device = self.world.torch_device
        self._steps = torch.zeros(self.num_envs, dtype=torch.long, device=device)
        self._over = torch.zeros(self.num_envs, dtype=torch.bool, device=device)
        self._draws = torch.Generator(device).manual_seed(seed)
        return self._given(self.world.state.clone()), self._info()

    def step(self, actions) -> tuple[Any, Any, Any, Any, dict]:
        """One control step. Raises InputError where actions have another shape or are not finite."""
        w, over = self.world, self._over
        w.step(actions)
        (again,) = torch.nonzero(over, as_tuple=True)
        w.restart(again, torch.randint(self._count, again.shape, generator=self._draws, device=again.device))
        self._steps = torch.where(over, 0, self._steps + 1)
        terminated = (w.success | w.failure) & ~over
        truncated = (self._steps >= self._most) & ~terminated
        self._over = terminated | truncated
        reward = (w.success & ~over).to(torch.float32)
        return (*map(self._given, (w.state.clone(), reward, terminated, truncated)), self._info())

    def _given(self, tensor: torch.Tensor):
        return tensor if self._torch else tensor.cpu().numpy()

    def _info(self) -> dict:
        flags = {"is_success": self.world.success, "is_failure": self.world.failure}
        return {name: self._given(flag.clone()) for name, flag in flags.items()}
