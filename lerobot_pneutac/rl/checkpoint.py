"""Learning curve and checkpoint of a training, so that one that was stopped goes on."""

import json
import time
from collections.abc import Callable
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from lerobot_pneutac.rl.reward import WEIGHTS
from pneutac_sim.errors import InputError
from pneutac_sim.files import whole, write_json

CHECKPOINT, CURVE = "checkpoint.safetensors", "curve.json"


class Keeper(BaseCallback):
    """Writes both after every update.

    Attributes:
        curve: a row an update: `steps`, `return` and `success` (means of the last 100 episodes, None before
            one has ended), `seconds` of all goes together, `action_std`, and `terms`, the reward's weighted
            terms, means over the steps.
    """

    def __init__(self, out: Path, run: dict, progress: Callable[[str, int], None]):
        """A keeper.

        Args:
            out: folder.
            run: what must be equal for a training to go on.
            progress: is called with a few words and the steps done after every rollout.
        """
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
        notes = {
            "run": json.dumps(self._run),
            "steps": str(self.model.num_timesteps),
            "curve": json.dumps(self.curve),
        }
        with whole(self._out / CHECKPOINT) as part:
            save_file(tensors, part, notes)
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
            raise InputError(
                f"'{self._out}' holds a training with another {', '.join(changed)}; give a new folder, or"
                " repeat the command that began it."
            )
        policy, state = model.policy, {}
        networks = {}
        for name, tensor in tensors.items():
            kind, rest = name.split(".", 1)
            if kind == "policy":
                networks[rest] = tensor
            else:
                i, key = rest.split(".")
                state.setdefault(int(i), {})[key] = tensor
        policy.load_state_dict(networks)
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
        row = {
            "steps": self.model.num_timesteps,
            "return": float(sum(e["r"] for e in episodes) / len(episodes)) if episodes else None,
            "success": float(sum(wins) / len(wins)) if wins else None,
            "seconds": self._before_s + time.monotonic() - self._began,
            "action_std": float(self.model.policy.log_std.exp().mean().detach()),
            "terms": {k: v / self._count for k, v in self._terms.items()},
        }
        self._terms, self._count = dict.fromkeys(WEIGHTS, 0.0), 0
        self.curve.append(row)
        words = "no trial has ended" if row["success"] is None else f"success {100 * row['success']:.0f} %"
        self._progress(words, row["steps"])
