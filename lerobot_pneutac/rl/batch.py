"""`PpoEnv` in many worlds that step together, on a GPU or a CPU, for Stable-Baselines3."""

import numpy as np
import torch
from gymnasium.utils.seeding import np_random
from stable_baselines3.common.vec_env import VecEnv

from lerobot_pneutac.rl import env as E
from pneutac_sim.features import ACTION_NAMES
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import converged, solved_joints
from pneutac_sim.world.batch import BatchedWorld

STARTS = 4  # that are drawn for each world at a reset; later episodes begin at any of them


def _pool(depth_mm: torch.Tensor) -> torch.Tensor:
    """`env.pool` of probe grids (N, 80, 59) on their device: (N, 10, 8)."""
    rows = torch.stack([part.amax(1) for part in depth_mm.tensor_split(E.POOL_ROWS[1:].tolist(), 1)], 1)
    return torch.stack([part.amax(2) for part in rows.tensor_split(E.POOL_COLS[1:].tolist(), 2)], 2)


class BatchedPpoEnv(VecEnv):
    """N worlds with the observations, actions and rewards of `PpoEnv`, whose options it takes.

    After `seed(s)` and `reset` world i begins where `PpoEnv.reset(seed=s + i)` does; its first episode ends
    after a random part of the time, so that later the worlds are at different moments of their episodes and
    an update sees all of these. Slides stand for the arm, whose joints are those of its inverse kinematics.
    The worlds' device is `cpu` or `cuda`, their task `switch`, `egg` or `card`.

    Raises InputError: as `PpoEnv` and `BatchedWorld`.
    """

    def __init__(self, task: str, twin: Twin | None, envs: int, device: str, **options):
        self.one = one = E.PpoEnv(task, twin, **options)
        shared = {"conditions": options.get("conditions"), "station": options.get("station")}
        self.world = BatchedWorld(task, envs, twin, device, "probe", **shared)
        self._view, self._arm = E.TaskView(self.world.single), one.world.arm
        self._solver, self._begins = self._arm.solver(), self._arm.solver()
        self._solver.reset(np.tile(self._arm.home_rad, (envs, 1)))
        self.render_mode = None
        super().__init__(envs, one.observation_space, one.action_space)

    def reset(self) -> dict[str, np.ndarray]:
        first = self._seeds[0] if self._seeds[0] is not None else int(np.random.default_rng().integers(2**31))
        self._draws, N = np.random.default_rng(first), self.num_envs
        count = STARTS * N
        drawn = [E.draw_start(np_random(first + k)[0], self.one.randomise) for k in range(count)]
        seeds, variations = zip(*drawn, strict=True)
        self.world.reset(np.array(seeds), count, variations)
        self._factors = np.array([(v.friction, v.bend_gain) for v in variations])
        self._previous, self._done = np.zeros((N, len(ACTION_NAMES))), np.zeros(N, int)
        self._start, self._progress = np.arange(N), np.zeros(N)
        self._begin(np.arange(N))
        self._done = self._draws.integers(self.one.length, size=N)
        self._reset_seeds()
        return self._observe()

    def _begin(self, worlds: np.ndarray) -> None:
        self._previous[worlds], self._done[worlds] = 0.0, 0
        self._moment = self._look(worlds)
        self._begins.reset(np.tile(self._arm.home_rad, (len(worlds), 1)))
        converged(self._begins, self._flange_m[worlds])
        self._solver.q[worlds] = self._begins.q

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict]]:
        w, normal = self.world, np.clip(self._actions, -1, 1).astype(float)
        w.step(E.to_action(normal, self.one.world.pressure_range_kpa))
        before, self._moment = self._moment, self._look(np.arange(self.num_envs))
        terms = E.reward_terms(before, self._moment, self._view.goal.depth_mm, self._previous, normal)
        self._previous, self._done = normal, self._done + 1
        won, lost = self._moment.success, self._moment.failure
        over = won | lost | (self._done >= self.one.length)
        observed, infos = self._observe(), []
        for i in range(self.num_envs):
            info = {"terms": {k: float(v[i]) for k, v in terms.items()}, "is_success": bool(won[i])}
            info["failure"] = w.why_failed(i) if lost[i] else ""
            if over[i]:
                info["TimeLimit.truncated"] = not (won[i] or lost[i])
                info["terminal_observation"] = {k: v[i] for k, v in observed.items()}
            infos.append(info)
        if over.any():
            (ended,) = np.nonzero(over)
            self._start[ended] = self._draws.integers(len(self._factors), size=len(ended))
            w.restart(*(torch.as_tensor(x, device=w.torch_device) for x in (ended, self._start[ended])))
            self._begin(ended)
            observed = self._observe()
        return observed, E.total(terms).astype(np.float32), over, infos

    def _look(self, changed: np.ndarray) -> E.Moment:
        """At all worlds, of which some have changed since."""
        w, fetched = self.world, lambda tensor: tensor.cpu().numpy()
        qpos = fetched(w.qpos).astype(float)
        for i in changed:  # the task's own class says how far it is
            w.single.data.qpos[:] = qpos[i]
            self._progress[i] = self._view.progress(w.single.task)
        rows = (*w.poses.values(), w.fields["body_pos"], w.fields["body_quat"])
        self._seen: E.Seen = self._view.seen_in(
            *map(fetched, rows), qpos, fetched(w.qvel), self._progress.copy()
        )
        self._state, self._cells_mm = fetched(w.state).astype(float), fetched(_pool(w.depth_mm))
        self._flange_m = self._state[:, :3] - self._arm.base_m
        deepest = self._cells_mm.max((1, 2))
        return E.Moment(
            self._seen.progress, self._seen.distance_m, deepest, fetched(w.success), fetched(w.failure)
        )

    def _observe(self) -> dict[str, np.ndarray]:
        joints = solved_joints(self._solver, self._flange_m, self._state[:, 3:6], self.world.dt_s)
        state = np.concatenate([*joints, self._flange_m, self._state[:, 6:]], 1)
        return {
            "actor": E.actor_observation(self.one.world, state, self._previous, self._cells_mm),
            "object": E.critic_observation(self._seen, *self._factors[self._start].T),
        }

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name, indices=None) -> list:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None) -> None:
        raise NotImplementedError

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs) -> list:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        return [False] * self.num_envs
