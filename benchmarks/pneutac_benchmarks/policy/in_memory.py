"""Training of `pneutac_bc` from memory, where each frame lies pooled.

lerobot-train decodes a frame again for every sample, 5 ms each on a CPU core: 43 minutes of 8,000 updates of
64, which take four here, and the benchmark trains hundreds of policies. Loss, optimiser and checkpoints are
the same.
"""

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.memory import of_episodes
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import Demonstrations, PneutacBCPolicy, Scaling
from lerobot_robot_pneutac.policy.tactile_encoder import check_same_sensor
from pneutac_benchmarks.policy.frames import Frames
from pneutac_sim.errors import InputError, check_least
from pneutac_sim.features import ACTION_NAMES, IMAGE_SHAPE, STATE_NAMES

VALIDATION_BATCH = 1024


@dataclass
class Training:
    """What a training came to.

    Attributes:
        curve: a row every few updates: `update`, `loss` (mean since the row before, with the noise of
            training) and, where episodes are held out, `held_out`, the loss on them without that noise.
        best: update whose weights the policy has now.
        held_out: loss of these weights on the episodes held out; None where there are none.
        lr: learning rate of the optimiser at the beginning.
    """

    curve: list[dict]
    best: int
    held_out: float | None
    lr: float


def new_policy(
    use_tactile: bool,
    lr: float,
    seed: int,
    device: str,
    scaling: Scaling | None = None,
    memory: bool = False,
    huber_delta: float = 0.0,
    networks: int = 1,
) -> PneutacBCPolicy:
    """A policy with random weights and no rest image yet, scaled by data or else by the paper's ranges."""
    inputs = {OBS_STATE: PolicyFeature(FeatureType.STATE, (len(STATE_NAMES),))}
    if use_tactile:
        inputs[TACTILE] = PolicyFeature(FeatureType.VISUAL, (IMAGE_SHAPE[2], *IMAGE_SHAPE[:2]))
    config = PneutacBCConfig(
        device=device,
        use_tactile=use_tactile,
        memory=memory,
        huber_delta=huber_delta,
        networks=networks,
        optimizer_lr=lr,
        action_feature_names=list(ACTION_NAMES),
        input_features=inputs,
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (len(ACTION_NAMES),))},
    )
    torch.manual_seed(seed)
    policy = PneutacBCPolicy(config)
    for name, value in ({} if scaling is None else scaling.tensors()).items():
        policy.get_buffer(name).copy_(value)
    return policy.to(device)


def held_out_episodes(episodes: int, share: float, seed: int) -> list[int]:
    """Episodes for validation: a share of all, at least one, and never all.

    Raises:
        InputError: there are fewer than two episodes.
    """
    if episodes < 2:
        raise InputError(f"There are {episodes} demonstrations; one more than is held out, so 2, are needed.")
    n = min(max(round(share * episodes), 1), episodes - 1)
    return sorted(np.random.default_rng(seed).permutation(episodes)[:n].tolist())


def train(
    policy: PneutacBCPolicy,
    frames: Frames,
    updates: int,
    batch: int,
    seed: int,
    held_out: Sequence[int] = (),
    copies: Sequence[int] = (),
    rows: int = 40,
    progress: Callable[[int, float], None] = lambda update, loss: None,
) -> Training:
    """Trains with the optimiser that the policy's options name; where the policy is, `cpu` or `cuda`.

    The policy takes the rest image of the data, as in lerobot-train. With episodes held out it ends with the
    weights that have the lowest loss on them, else with the last.

    Args:
        policy: with new weights or those of another training.
        frames: the data.
        updates: gradient steps.
        batch: samples of each.
        seed: decides order and noise.
        held_out: episodes that are not trained on.
        copies: of each episode, how often it is there, as in a dataset that `augment` has mixed; where left
            out, once.
        rows: rows of the curve, about.
        progress: is called with update and loss at every row.

    Raises:
        InputError: a number is too small, no frame is left, the rest image is another sensor's, or the loss
            is not finite.
    """
    check_least(1, updates=updates, batch=batch)
    away = np.isin(frames.episode, list(held_out))
    if away.all():
        raise InputError("All episodes are held out; leave at least one to train on.")
    device = next(policy.parameters()).device
    learn_from(policy, frames)
    data = _Data(frames, policy, device)
    torch.manual_seed(seed)
    times = np.where(
        away, 0, np.ones(len(frames), int) if not len(copies) else np.take(copies, frames.episode)
    )
    order = _batches(np.repeat(np.arange(len(frames)), times), batch, np.random.default_rng(seed))
    curve, best = [], (np.inf, updates, None)
    for update, loss in _optimise(policy, data, order, updates, max(updates // rows, 1)):
        row = {"update": update, "loss": loss}
        if away.any():
            row["held_out"] = _mean_loss(policy, data, np.flatnonzero(away))
            if row["held_out"] < best[0]:
                best = row["held_out"], update, copy.deepcopy(policy.state_dict())
        curve.append(row)
        progress(update, loss)
    if best[2] is not None:
        policy.load_state_dict(best[2])
    policy.eval()
    held_out_loss = float(best[0]) if best[2] is not None else None
    return Training(curve, best[1], held_out_loss, policy.config.optimizer_lr)


def _optimise(
    policy: PneutacBCPolicy, data: "_Data", order: Iterator[np.ndarray], updates: int, every: int
) -> Iterator[tuple[int, float]]:
    """Makes all gradient steps; gives update and mean loss since the last time, every so many of them."""
    optimiser = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    scheduler = policy.config.get_scheduler_preset().build(optimiser, updates)
    total, since = 0.0, 0
    policy.train()
    for update in range(1, updates + 1):
        loss, _ = policy.loss(*data.at(next(order)))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        scheduler.step()
        total, since = total + loss.detach(), since + 1
        if update % every == 0 or update == updates:
            yield update, float(total) / since
            total, since = 0.0, 0


def save(policy: PneutacBCPolicy, training: Training, folder: str | Path) -> Path:
    """Writes `checkpoints/<update>/pretrained_model` as lerobot-train does; returns that folder."""
    folder = Path(folder) / "checkpoints" / f"{training.best:06d}" / "pretrained_model"
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(policy.config):
        processor.save_pretrained(folder)
    return folder


class _Data:
    """Samples where the policy is; the differences stay in half precision until they are used."""

    def __init__(self, frames: Frames, policy: PneutacBCPolicy, device: torch.device):
        arrays = (frames.state, frames.previous, frames.first, frames.action)
        self._arrays = [torch.from_numpy(a).to(device) for a in arrays]
        self._recalled = None
        if policy.config.memory:
            options = policy.config.chambers, policy.config.control_hz
            found = of_episodes(torch.from_numpy(frames.state), frames.episode, *options)
            self._recalled = found.to(device)
        self._device, self._difference = device, None
        if policy.encoder is not None:
            self._difference = torch.cat([self._seen(policy, some) for some in _parts(frames.images)])

    def _seen(self, policy: PneutacBCPolicy, images: np.ndarray) -> torch.Tensor:
        some = torch.from_numpy(images).to(self._device).permute(0, 3, 1, 2).float() / 255
        return policy.encoder.difference(some).half()

    def at(self, rows: np.ndarray) -> tuple[torch.Tensor | None, ...]:
        """Arguments of `PneutacBCPolicy.loss`."""
        rows = torch.from_numpy(rows).to(self._device)
        difference = None if self._difference is None else self._difference[rows].float()
        recalled = None if self._recalled is None else self._recalled[rows]
        return *(a[rows] for a in self._arrays), difference, recalled


def _parts(images: np.ndarray) -> list[np.ndarray]:
    return [images[k : k + VALIDATION_BATCH] for k in range(0, len(images), VALIDATION_BATCH)]


def learn_from(policy: PneutacBCPolicy, frames: Frames) -> None:
    """Gives a policy the frames' rest image, and their number for its card.

    Raises:
        InputError: the rest image cannot be of the kind of sensor that the policy knows.
    """
    policy._demonstrations = _card(frames)
    if policy.encoder is not None:
        policy._dataset_rest = frames.rest.to(policy.encoder.rest_image.device)
        check_same_sensor(policy.encoder.rest_image, policy._dataset_rest, policy._demonstrations.repo_id)
        policy._take_dataset_rest()


def _card(frames: Frames) -> Demonstrations:
    """What a model card says of the data."""
    return Demonstrations("benchmark", frames.episodes, len(frames), ())


def _batches(rows: np.ndarray, batch: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Endless batches; every row comes once before any comes again."""
    waiting = rows[:0]
    while True:
        while len(waiting) < batch:
            waiting = np.concatenate([waiting, rng.permutation(rows)])
        yield waiting[:batch]
        waiting = waiting[batch:]


@torch.no_grad()
def _mean_loss(policy: PneutacBCPolicy, data: _Data, rows: np.ndarray) -> float:
    """Mean over samples, without noise."""
    policy.eval()
    total = 0.0
    for start in range(0, len(rows), VALIDATION_BATCH):
        some = rows[start : start + VALIDATION_BATCH]
        total += policy.loss(*data.at(some))[0].item() * len(some)
    policy.train()
    return total / len(rows)
