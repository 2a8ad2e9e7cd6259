"""The trained actor: a small network and how it is stored, in PyTorch alone."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import nn

from lerobot_pneutac.rl.env import GRID, actor_size
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, PANDA_JOINTS
from pneutac_sim.files import whole, write_json

WEIGHTS_FILE, CARD_FILE = "actor.safetensors", "actor.json"


def layers(inputs: int, hidden: tuple[int, ...]) -> nn.Sequential:
    """Fully connected layers with tanh between them, and after the last."""
    sizes = (inputs, *hidden)
    parts = [f for a, b in zip(sizes, sizes[1:], strict=False) for f in (nn.Linear(a, b), nn.Tanh())]
    return nn.Sequential(*parts)


class Actor(nn.Module):
    """Takes what is felt to the mean action; `card` is what is known of it: task, training, success."""

    def __init__(self, hidden: tuple[int, ...], card: dict | None = None, joints: int = PANDA_JOINTS):
        super().__init__()
        self.body, self.head = layers(actor_size(joints), hidden), nn.Linear(hidden[-1], len(ACTION_NAMES))
        self.hidden, self.card, self.joints = tuple(hidden), dict(card or {}), joints

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Mean actions (N, 4), not limited, of observations (N, actor_size)."""
        return self.head(self.body(observation))

    @torch.no_grad()
    def act(self, observation: np.ndarray) -> np.ndarray:
        """The mean action (4,) in [-1, 1] of one observation (actor_size,); `to_action` gives its units."""
        mean = self(torch.as_tensor(observation, dtype=torch.float32)[None])[0]
        return mean.clamp(-1, 1).double().numpy()

    def save(self, folder: str | Path) -> None:
        folder = Path(folder)
        tensors = {k: v.detach().cpu().contiguous() for k, v in self.state_dict().items()}
        with whole(folder / WEIGHTS_FILE) as part:
            part.write_bytes(save(tensors))
        card = {"hidden": list(self.hidden), "grid": list(GRID), "joints": self.joints, **self.card}
        write_json(folder / CARD_FILE, card)

    @classmethod
    def load(cls, folder: str | Path) -> "Actor":
        """Reads an actor; raises InputError where a file is missing, damaged or of another observation."""
        folder = Path(folder)
        for name in (WEIGHTS_FILE, CARD_FILE):
            if not (folder / name).is_file():
                raise InputError(f"'{folder}' holds no {name}; give a folder that `pneutac ppo` wrote.")
        try:
            card = json.loads((folder / CARD_FILE).read_text())
            hidden = tuple(int(n) for n in card.pop("hidden"))
            grid = tuple(card.pop("grid"))
            actor = cls(hidden, card, int(card.pop("joints", PANDA_JOINTS)))
        except (ValueError, KeyError, TypeError, AttributeError, IndexError) as e:
            no_card = f"'{folder / CARD_FILE}' is not an actor's card with 'hidden' and 'grid'"
            raise InputError(f"{no_card}; train it again.") from e
        if grid != GRID:
            raise InputError(f"'{folder / CARD_FILE}' has the grid {grid}; an actor here has {GRID}.")
        try:
            tensors = load_file(folder / WEIGHTS_FILE)
            actor.load_state_dict(tensors)
        except (SafetensorError, RuntimeError) as e:
            other = f"not of the network that {CARD_FILE} names"
            raise InputError(f"'{folder / WEIGHTS_FILE}' is damaged or {other}.") from e
        if not all(t.isfinite().all() for t in tensors.values()):
            raise InputError(f"'{folder / WEIGHTS_FILE}' holds numbers that are not finite; train it again.")
        return actor.eval()


def try_actor(actor: Actor, env, episodes: int, seed: int) -> dict:
    """Rolls the mean actions out: `success` (share), `episodes`, `return`, `steps` (means) and `failures`."""
    wins, returns, steps, failures = 0, 0.0, 0, Counter()
    for k in range(episodes):
        observed, _ = env.reset(seed=seed if k == 0 else None)
        over = False
        while not over:
            observed, reward, terminated, truncated, info = env.step(actor.act(observed["actor"]))
            over, steps, returns = terminated or truncated, steps + 1, returns + reward
        wins += info["is_success"]
        failures.update(filter(None, [info["failure"]]))
    found = {"success": wins / episodes, "episodes": episodes, "return": float(returns / episodes)}
    return found | {"steps": steps / episodes, "failures": dict(failures)}
