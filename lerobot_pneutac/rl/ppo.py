"""Proximal policy optimisation (Schulman et al., 2017) with an actor that feels and a critic that sees more.

The library is Stable-Baselines3: it adds one package to what is installed already, runs worlds of one core
each in processes, and takes a policy whose two networks read different parts of the observation. Its vector
environment is also what `batch.BatchedPpoEnv` is, whose worlds step together on a GPU. On disk are
safetensors and JSON; the library's own archive holds pickles and is not used.

Learning curve and checkpoint of a training, so that one that was stopped goes on.
"""

import functools
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecMonitor
from torch import nn

from lerobot_pneutac.rl.actor import Actor, layers, try_actor
from lerobot_pneutac.rl.env import WEIGHTS, PpoEnv
from pneutac_sim.errors import InputError, check_least
from pneutac_sim.executor import Progress, check_device, no_progress
from pneutac_sim.features import CONTROL_HZ, PANDA_JOINTS
from pneutac_sim.files import whole, write_json
from pneutac_sim.twin import Twin, twin_digest
from pneutac_sim.world.station import Station

CHECKPOINT, CURVE = "checkpoint.safetensors", "curve.json"
WINDOW = 100  # episodes of which the curve has the mean, at least
LEAST_STEPS = 64  # of each world between two updates: with 16 the card was not learned


class Keeper(BaseCallback):
    """Writes checkpoint and curve after every update.

    The `curve` has a row an update: `steps`, `return` and `success` (means of the last 100 episodes, or as
    many as there are worlds; None before one has ended), `seconds` of all goes together, `action_std`, and
    `terms`, the weighted means.
    """

    def __init__(self, out: Path, run: dict, progress: Callable[[str, int], None]):
        super().__init__()
        self.curve: list[dict] = []
        self._out, self._run, self._progress = out, run, progress
        self._terms, self._count = dict.fromkeys(WEIGHTS, 0.0), 0
        self._before_s, self._began = 0.0, time.monotonic()

    def save(self) -> None:
        """Writes networks, optimiser and curve; each file appears whole or not at all."""
        policy = self.model.policy
        tensors = {f"policy.{k}": v for k, v in policy.state_dict().items()}
        for i, values in policy.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{i}.{k}": v for k, v in values.items()}
        tensors = {k: v.detach().cpu().contiguous() for k, v in tensors.items()}
        notes = {"run": self._run, "steps": self.model.num_timesteps, "curve": self.curve}
        notes = {name: json.dumps(value) for name, value in notes.items()}
        with whole(self._out / CHECKPOINT) as part:
            part.write_bytes(save(tensors, notes))
        write_json(self._out / CURVE, self.curve)

    def resume(self, model: PPO) -> None:
        """Puts the checkpoint into the optimiser; raises InputError where it is damaged or another run's."""
        file = self._out / CHECKPOINT
        try:
            with safe_open(file, "pt") as f:
                notes = f.metadata() or {}
                tensors = {k: f.get_tensor(k) for k in f.keys()}  # noqa: SIM118, it is no dict
            run, steps, curve = json.loads(notes["run"]), int(notes["steps"]), json.loads(notes["curve"])
        except (SafetensorError, KeyError, ValueError) as e:
            raise InputError(f"'{file}' is damaged; delete it to start again.") from e
        changed = [k for k in sorted(run.keys() | self._run.keys()) if run.get(k) != self._run.get(k)]
        if changed:
            other = f"'{self._out}' holds a training with another {', '.join(changed)}"
            raise InputError(f"{other}; give a new folder, or repeat the command that began it.")
        policy, state = model.policy, {}
        for name in [n for n in tensors if n.startswith("optimizer.")]:
            _, i, key = name.split(".")
            state.setdefault(int(i), {})[key] = tensors.pop(name)
        policy.load_state_dict({n.removeprefix("policy."): t for n, t in tensors.items()})
        policy.optimizer.load_state_dict(policy.optimizer.state_dict() | {"state": state})
        model.num_timesteps, self.curve = steps, curve
        self._before_s = curve[-1]["seconds"]

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            for name, value in info["terms"].items():
                self._terms[name] += WEIGHTS[name] * value
        self._count += len(self.locals["infos"])
        return True

    def _on_rollout_start(self) -> None:
        if self.curve and self.curve[-1]["steps"] == self.model.num_timesteps:  # updated since
            self.save()

    def _on_rollout_end(self) -> None:
        episodes, wins = self.model.ep_info_buffer, self.model.ep_success_buffer
        gained = [e["r"] for e in episodes]
        row = {"steps": self.model.num_timesteps, "return": fmean(gained) if gained else None}
        row |= {"success": fmean(wins) if wins else None}
        row |= {"seconds": self._before_s + time.monotonic() - self._began}
        row |= {"action_std": float(self.model.policy.log_std.exp().mean().detach())}
        row |= {"terms": {k: v / self._count for k, v in self._terms.items()}}
        self._terms, self._count = dict.fromkeys(WEIGHTS, 0.0), 0
        self.curve.append(row)
        words = "no trial has ended" if row["success"] is None else f"success {100 * row['success']:.0f} %"
        self._progress(words, row["steps"])


TEST_SEED = 1_000_000  # starts of the test are none of the training's


@dataclass(frozen=True)
class PpoSettings:
    """Numbers of the optimiser."""

    hidden: tuple[int, ...] = (128, 128)  # sizes of the hidden layers of actor and critic
    update_steps: int = 2048  # steps of all worlds together between two updates, about
    batch: int = 256  # samples of a gradient step
    epochs: int = 8  # passes over the steps of an update
    learning_rate: float = 1e-3  # of Adam
    discount: float = 0.99  # of the reward, per 1/15 s
    trace: float = 0.95  # lambda of the generalised advantage estimate
    clip: float = 0.2  # how far a probability ratio may move in one update
    entropy: float = 0.001  # weight of the entropy bonus
    log_std: float = -0.5  # logarithm of the actions' first standard deviation; they reach from -1 to 1


@dataclass(frozen=True)
class Compute:
    """How a training is carried out; it may go on with other numbers."""

    envs: int = 8  # worlds stepped together
    parallel: bool = False  # whether each has a process of its own
    device: str = "cpu"  # `cpu` or `cuda`, of the networks, and of worlds that are a batch
    batch: bool = False  # whether worlds are stepped together by MuJoCo Warp, see `BatchedPpoEnv`
    tries: int = 50  # trials of the test after training

    def check(self, steps: int) -> None:
        """Raises InputError where a number is too small, or the device is missing."""
        check_least(1, steps=steps, envs=self.envs, tries=self.tries)
        check_device(self.device)


class Asymmetric(nn.Module):
    """Hidden layers of both networks: the actor's read the first `felt` entries, the critic's all."""

    def __init__(self, inputs: int, actor_inputs: int, hidden: tuple[int, ...]):
        super().__init__()
        self.actor_inputs = actor_inputs
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1]
        self.actor, self.critic = layers(actor_inputs, hidden), layers(inputs, hidden)

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        return self.actor(features[:, : self.actor_inputs])

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        return self.critic(features)


class AsymmetricPolicy(MultiInputActorCriticPolicy):
    """The library's Gaussian policy around `Asymmetric`; `actor` comes before `object` in the features."""

    def _build_mlp_extractor(self) -> None:
        actor_inputs = self.observation_space["actor"].shape[0]
        self.mlp_extractor = Asymmetric(self.features_dim, actor_inputs, tuple(self.net_arch))


def make_worlds(task: str, twin: Twin | None, compute: Compute, **options) -> VecEnv:
    """Worlds stepped together: a batch, or each in a process of its own, or one after the other."""
    if compute.batch:
        from lerobot_pneutac.rl.batch import BatchedPpoEnv  # it brings Warp

        return VecMonitor(BatchedPpoEnv(task, twin, compute.envs, compute.device, **options))
    make = [functools.partial(PpoEnv, task, twin, **options)] * compute.envs
    return VecMonitor(SubprocVecEnv(make) if compute.parallel else DummyVecEnv(make))


def make_ppo(worlds: VecEnv, seed: int, device: str, s: PpoSettings, control_hz: int = CONTROL_HZ) -> PPO:
    per_world = max(s.update_steps // worlds.num_envs, LEAST_STEPS)
    steps = {"n_steps": per_world, "batch_size": min(s.batch, per_world * worlds.num_envs)}
    loss = {"clip_range": s.clip, "ent_coef": s.entropy, "gae_lambda": s.trace}
    loss["gamma"] = s.discount ** (CONTROL_HZ / control_hz)
    how = {"n_epochs": s.epochs, "learning_rate": s.learning_rate, "seed": seed, "device": device}
    how["stats_window_size"] = max(WINDOW, worlds.num_envs)  # fewer are those that ended together, all alike
    policy = {"net_arch": list(s.hidden), "log_std_init": s.log_std}
    return PPO(AsymmetricPolicy, worlds, policy_kwargs=policy, **steps, **loss, **how)


def train_ppo(
    task: str,
    twin: Twin | None,
    seed: int,
    steps: int,
    out: str | Path,
    compute: Compute | None = None,
    settings: PpoSettings | None = None,
    progress: Progress = no_progress,
    **options,
) -> dict:
    """Trains an actor, and goes on where a training in `out` was stopped.

    `out` gets `actor.safetensors`, `actor.json`, `curve.json` and, after every update, a checkpoint. One that
    goes on starts new episodes, so its numbers are not those that an uninterrupted one would have had.

    Returns what `actor.json` holds: `task`, `seed`, `steps`, `seconds`, `steps_per_s`, `settings`, `weights`
    and, under `test`, the result of `try_actor` on starts that the training had not. `options` are those of
    `PpoEnv`. Raises InputError where a number is too small, the device is missing, or `out` holds another
    training.
    """
    compute, settings, out = compute or Compute(), settings or PpoSettings(), Path(out)
    compute.check(steps)
    env = PpoEnv(task, twin, **options)  # refuses a bad task or twin before anything is written
    run = {"task": task, "twin": twin_digest(twin) if twin else None, "seed": seed}
    run["settings"] = asdict(settings)
    plain = {k: asdict(v) if isinstance(v, Station) else v for k, v in options.items()}
    run = json.loads(json.dumps(run | {"weights": WEIGHTS, "options": plain}))
    worlds = make_worlds(task, twin, compute, **options)
    try:
        model = make_ppo(worlds, seed, compute.device, settings, env.world.station.control_hz)
        keeper = Keeper(out, run, lambda text, done: progress(text, min(done, steps), steps))
        if (out / CHECKPOINT).exists():
            keeper.resume(model)
        out.mkdir(parents=True, exist_ok=True)
        worlds.seed(seed * 1009 + model.num_timesteps)
        if model.num_timesteps < steps:
            model.learn(steps - model.num_timesteps, keeper, reset_num_timesteps=False)
            keeper.save()
    finally:
        worlds.close()
    actor, seconds = actor_of(model, settings, env.world.arm.joints), keeper.curve[-1]["seconds"]
    progress(f"trying the actor on {compute.tries} new starts", steps, steps)
    found = {"steps": model.num_timesteps, "seconds": seconds, "steps_per_s": model.num_timesteps / seconds}
    actor.card = run | found | {"test": try_actor(actor, env, compute.tries, TEST_SEED + seed)}
    actor.save(out)
    return actor.card


def actor_of(model: PPO, settings: PpoSettings, joints: int = PANDA_JOINTS) -> Actor:
    """A copy of the actor's networks, on the CPU."""
    actor = Actor(settings.hidden, joints=joints)
    actor.body.load_state_dict(model.policy.mlp_extractor.actor.state_dict())
    actor.head.load_state_dict(model.policy.action_net.state_dict())
    return actor.eval()
