"""The policy `pneutac_bc`: |tactile - rest| through a convolutional encoder, with the state into an MLP.

The paper's policy network and loss (Sec. "Policy training"): a 64-D embedding of the tactile difference
with a 24-D observation {q, q', x, s/N, log(1+s), p, a_(t-1)}, two hidden layers of 256, 4-D action. Beyond
the paper, and off with `memory=False`: what it remembers of the episode, see `memory`; with `huber_delta` a
loss in which large errors weigh less; and with `networks=3` the mean of three such networks. Both are the
default on what `pneutac augment --method=library` made.

How the policy scales state and action: about what its demonstrations show, in units of what matters.

The model card of a `pneutac_bc` checkpoint: its README.md, for whoever finds the weights alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import torch
from huggingface_hub import ModelCard, ModelCardData
from lerobot.configs.train import TrainPipelineConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_STATE
from safetensors import safe_open
from torch import Tensor, nn
from torch.nn.functional import huber_loss

from lerobot_robot_pneutac.policy import memory
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import (
    PREVIOUS_ACTION,
    TACTILE,
    PneutacBCConfig,
    ahead,
    frames_ahead,
)
from lerobot_robot_pneutac.policy.memory import AREA, POSITION_M
from lerobot_robot_pneutac.policy.tactile_encoder import (
    DIFFERENCE_SCALE,
    EMBEDDING,
    TactileEncoder,
    check_same_sensor,
    layers,
    rest_image_of,
)
from pneutac_sim import features
from pneutac_sim.errors import InputError
from pneutac_sim.features import (
    PANDA_JOINTS,
    PAPER_RANGE_KPA,
    PRESSURES,
    Places,
    action_limits,
    action_names,
    state_names,
)


@dataclass(frozen=True)
class Demonstrations:
    """What a card says about the data that a policy was trained on."""

    repo_id: str  # of the dataset
    episodes: int  # their number
    frames: int  # their number
    tasks: tuple[str, ...]  # instructions stored with the frames

    @classmethod
    def of(cls, meta) -> "Demonstrations":
        """Reads them from a LeRobotDatasetMetadata."""
        return cls(meta.repo_id, meta.total_episodes, meta.total_frames, tuple(map(str, meta.tasks.index)))


def model_card(
    config: PneutacBCConfig,
    demonstrations: Demonstrations | None = None,
    rest_level: tuple[float, float, float] | None = None,
    steps: int | None = None,
    train: TrainPipelineConfig | None = None,
    limits: tuple[Sequence[float], Sequence[float]] = (features.ACTION_LOW, features.ACTION_HIGH),
) -> ModelCard:
    """The card of one checkpoint.

    Args:
        config: the policy's options.
        demonstrations: the training data, where known; so are the following two.
        rest_level: mean of the rest image's channels R, G, B, of 255.
        steps: training steps.
        train: options of the whole training.
        limits: lowest and highest action (3 + C,).
    """
    data = ModelCardData(
        license=config.license or "apache-2.0",
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=sorted({*(config.tags or []), "lerobot", "robotics", config.type}),
        model_name=config.type,
        datasets=[demonstrations.repo_id] if demonstrations else None,
    )
    # A folder of this machine says nothing elsewhere, and a resumed training names its own checkpoint.
    known = config.pretrained_path and not Path(config.pretrained_path).is_dir()
    level = rest_level if config.use_tactile else None
    from pneutac_sim.world.tasks import tasks_named  # MuJoCo

    instructions = demonstrations.tasks if demonstrations else ()
    return ModelCard.from_template(
        data,
        template_path=str(Path(__file__).with_name("model_card_template.md")),
        config=config,
        data=demonstrations,
        steps=train.steps if steps is None and train is not None else steps,
        batch_size=None if train is None else train.batch_size,
        fine_tuned_from=Path(config.pretrained_path).as_posix() if known else None,
        features=_feature_rows(config, limits),
        task=next((task for text in instructions for task in tasks_named(text)), "switch"),
        rest_level=None if level is None else ", ".join(f"{v:.0f}" for v in level),
    )


def _feature_rows(
    config: PneutacBCConfig, limits: tuple[Sequence[float], Sequence[float]]
) -> list[tuple[str, str, str]]:
    """Feature, name or shape, and unit of all that goes in or comes out."""
    unused = () if config.use_tactile else ("contact_area.pos", "contact_pixels.pos")
    rows = [
        (OBS_STATE, f"`{n}`", features.unit_of(n) + (" (not looked at)" if n in unused else ""))
        for n in state_names(config.joints, config.chambers)
    ]
    if config.use_tactile:
        c, h, w = config.image_shape
        rows.append((TACTILE, f"{w} x {h} pixels, {c} channels, RGB", "0 to 1"))
    return rows + [
        (ACTION, f"`{n}`", f"{features.unit_of(n)}, {low:g} to {high:g}")
        for n, low, high in zip(action_names(config.chambers), *limits, strict=True)
    ]


# What counts as much, whatever the station: much less than a robot's limits, so that millimetres matter.
JOINT_RAD, JOINT_RAD_S, LOG_PIXELS = 0.3, 0.3, 4.0  # and `memory.POSITION_M`, `memory.AREA`
# The paper's station: a Panda whose flange points down at the table.
_PANDA_RAD = [0.0, 0.0, 0.0, -2.55, 0.0, 2.55, np.pi / 4]
LEAST_KPA = 0.1  # half the width of a range of pressures, at least


@dataclass(frozen=True)
class Scaling:
    """Centre, scale of a state (2 N + 5 + C,), N joints, C chambers; centre, scale, limits of an action."""

    state_centre: np.ndarray
    state_scale: np.ndarray
    action_centre: np.ndarray
    action_scale: np.ndarray
    action_low: np.ndarray
    action_high: np.ndarray

    @classmethod
    def paper(cls, joints: int = PANDA_JOINTS, chambers: int = 1) -> "Scaling":
        """That of the paper's station and finger, or of others there, for a policy without data."""
        limits = action_limits(PAPER_RANGE_KPA, chambers)
        return cls(*_state(joints, chambers), *_middle(*limits), *limits)

    @classmethod
    def of(cls, stats: dict) -> "Scaling":
        """That of a dataset.

        Joints and flange are taken about the middle of where they were; pressures, which differ between
        fingers, over the range that was commanded; velocities over the robot's range.

        Args:
            stats: of LeRobot, with `min` and `max` of `observation.state` and `action`.
        """
        state, action = stats["observation.state"], stats["action"]
        middle = (np.ravel(state["min"]) + np.ravel(state["max"])) / 2
        chambers = np.size(action["min"]) - len(features.VELOCITY_NAMES)
        joints, places = features.joint_count(len(middle), chambers), Places.of(chambers)
        low, high = action_limits(PAPER_RANGE_KPA, chambers)
        centre, scale = _state(joints, chambers)
        centre[:joints], centre[places.ee] = middle[:joints], middle[places.ee]
        low[PRESSURES] = np.minimum(np.ravel(action["min"])[PRESSURES], 0.0)
        high[PRESSURES] = np.maximum(np.ravel(action["max"])[PRESSURES], 0.0)
        middle, half = _middle(low, high)
        half[PRESSURES] = np.maximum(half[PRESSURES], LEAST_KPA)
        centre[places.pressure], scale[places.pressure] = middle[PRESSURES], half[PRESSURES]
        return cls(centre, scale, middle, half, low, high)

    def tensors(self) -> dict[str, torch.Tensor]:
        return {f"_{name}": torch.tensor(value, dtype=torch.float32) for name, value in vars(self).items()}


def _state(joints: int, chambers: int) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale (2 N + 5 + C,) of the state of an arm of N joints at the paper's station."""
    angles = _PANDA_RAD if joints == PANDA_JOINTS else [0.0] * joints
    kpa = [7.5] * chambers
    centre = np.array([*angles, *[0.0] * joints, 0.46, 0.0, 0.28, 0.0, LOG_PIXELS, *kpa])
    scale = [JOINT_RAD] * joints + [JOINT_RAD_S] * joints + [POSITION_M] * 3 + [AREA, LOG_PIXELS, *kpa]
    return centre, np.array(scale)


def _middle(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half width of ranges."""
    return (low + high) / 2, (high - low) / 2


HIDDEN = 256
REST = "encoder.rest_image"
FIRST = "mlp.0.weight"
SCALES = "_state_centre", "_action_centre"  # as long as state and action


def _mlp(width: int, actions: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(width, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, actions)
    )


class PneutacBCPolicy(PreTrainedPolicy):
    """Behaviour cloning from touch and proprioception; keeps its previous action and memory between calls.

    Attributes:
        encoder: of the tactile image; None with `use_tactile=False`.
    """

    config_class = PneutacBCConfig
    name = "pneutac_bc"

    def __init__(self, config: PneutacBCConfig, dataset_meta=None, **kwargs):
        """A policy with random weights.

        Args:
            config: options, with the features of the data.
            dataset_meta: LeRobotDatasetMetadata of the training data. Its rest image becomes the policy's,
                also where weights of another training are loaded afterwards; its statistics scale state and
                action, unless such weights bring the scale that they were trained with.
            **kwargs: what else LeRobot passes (dataset statistics) and this policy has no use for.

        Raises InputError: features or dataset do not fit.
        """
        super().__init__(config)
        self._dataset_rest = self._demonstrations = None
        if dataset_meta is not None:
            config.check_dataset(dataset_meta)
        config.control_hz = config.control_hz or features.CONTROL_HZ
        if config.memory is None:
            config.memory = dataset_meta is not None
        config.networks = config.networks or 1
        config.validate_features()
        if dataset_meta is not None:
            self._demonstrations = Demonstrations.of(dataset_meta)
            config.instructions = list(self._demonstrations.tasks)
            self._dataset_rest = rest_image_of(dataset_meta) if config.use_tactile else None

        self.encoder = TactileEncoder(config.image_shape) if config.use_tactile else None
        self._places = Places.of(config.chambers)
        sizes = config.joints, config.chambers
        size, actions = len(state_names(*sizes)), len(action_names(config.chambers))
        contact = (size + self._places.area, size + self._places.pixels)
        channels = [i for i in range(size) if config.use_tactile or i not in contact]
        self.register_buffer("_channels", torch.tensor(channels), persistent=False)
        # Saved with the weights, which mean nothing with another scale.
        self._dataset_scaling = None if dataset_meta is None else Scaling.of(dataset_meta.stats)
        for name, value in (self._dataset_scaling or Scaling.paper(*sizes)).tensors().items():
            self.register_buffer(name, value)
        recalled = memory.size(config.chambers) if config.memory else 0
        hidden = [] if config.use_tactile else memory.of_touch(config.chambers)
        seen = torch.tensor([i for i in range(recalled) if i not in hidden], dtype=torch.long)
        self.register_buffer("_recalled", seen, persistent=False)
        self._read(dataset_meta)
        width = len(channels) + len(self._recalled) + actions + (EMBEDDING if config.use_tactile else 0)
        self.mlp = _mlp(width, actions)
        self.others = nn.ModuleList(  # the first network's keys stay those of a policy of one
            nn.ModuleDict(
                {"mlp": _mlp(width, actions)}
                | ({"layers": layers(config.image_shape[0])} if config.use_tactile else {})
            )
            for _ in range(config.networks - 1)
        )
        self._take_dataset_rest()
        self.reset()

    def _read(self, meta) -> None:
        """Of every frame of a dataset: what is remembered there, and the action and the one before it."""
        config, found = self.config, {"_memories": None, "_labels": None, "_before": None, "_first": None}
        if meta is not None and (config.memory or config.answer_delay):
            columns = ["index", "episode_index", OBS_STATE, ACTION]
            table = parquet.read_table(meta.root / "data", columns=columns).sort_by("index")
            episode = table["episode_index"].to_numpy()
            state, action = (np.stack(table[k].to_numpy()).astype(np.float32) for k in (OBS_STATE, ACTION))
            if config.memory:
                sizes = config.chambers, config.control_hz
                found["_memories"] = memory.of_episodes(torch.from_numpy(state), episode, *sizes)
            if config.answer_delay:
                frames = frames_ahead(config.answer_delay, config.control_hz)
                moved = torch.from_numpy(ahead(action, state[:, self._places.area], episode, frames))
                first = torch.from_numpy(np.diff(episode, prepend=-1) != 0)
                found |= {"_labels": moved, "_before": moved.roll(1, 0), "_first": first}
        for name, values in found.items():
            self.register_buffer(name, values, persistent=False)

    @classmethod
    def _load_as_safetensor(cls, model, model_file, map_location, strict):
        """Loads weights; a rest image from the present dataset outlives the one in the file.

        Raises InputError: the file lacks weights or holds others, those of another body, or the two rest
        images cannot be of the same kind of sensor.
        """
        with safe_open(model_file, "pt") as file:
            if model.encoder is not None and REST in file.keys():
                model.config.check_size(tuple(file.get_slice(REST).get_shape()), str(model_file))
            other = sorted(set(file.keys()) ^ set(model.state_dict()))
            sizes = [file.get_slice(k).get_shape()[0] for k in SCALES if k in file.keys()]
            inputs = file.get_slice(FIRST).get_shape()[1] if FIRST in file.keys() else None
        if other:
            which = ", ".join(other[:3]) + ", ..." * (len(other) > 3)
            raise InputError(
                f"'{model_file}' does not hold the weights of this policy (differs in {which});"
                " its use_tactile or networks were others, or another version trained it: train again."
            )
        now = [len(model.state_dict()[k]) for k in SCALES]
        if sizes != now:
            raise InputError(
                f"'{model_file}' was trained on {sizes[0]} numbers of state and {sizes[1]} of action, and"
                f" here are {now[0]} and {now[1]}: an arm of other joints, or other chambers. Give those of"
                " its demonstrations (--env.twin, --env.station), or train again."
            )
        if inputs != model.mlp[0].in_features:
            raise InputError(
                f"'{model_file}' takes {inputs} numbers and this policy {model.mlp[0].in_features}: it was"
                f" trained {'without' if model.config.memory else 'with'} memory; give"
                f" --policy.memory={'false' if model.config.memory else 'true'}, or train again."
            )
        model = super()._load_as_safetensor(model, model_file, map_location, strict)
        for name, values in model.state_dict().items():
            if name != REST and not values.isfinite().all():
                raise InputError(f"'{model_file}': {name} contains NaN or infinity; train again.")
        if model._dataset_scaling is not None:
            model._reach(model._dataset_scaling)
        if model._dataset_rest is not None:
            check_same_sensor(model.encoder.rest_image, model._dataset_rest, model._demonstrations.repo_id)
            model._take_dataset_rest()
        return model

    def _reach(self, scaling: Scaling) -> None:
        """Widens the limits of the action to what another dataset demonstrates; the scale stays."""
        there = scaling.tensors()
        self._action_low.copy_(torch.minimum(self._action_low, there["_action_low"].to(self._action_low)))
        self._action_high.copy_(torch.maximum(self._action_high, there["_action_high"].to(self._action_high)))

    def _take_dataset_rest(self) -> None:
        if self._dataset_rest is not None:
            self.encoder.rest_image.copy_(self._dataset_rest)

    # ------------------------------------------------------------ model card

    def _save_pretrained(self, save_directory: Path, **kwargs) -> None:
        """Saves options, weights and the model card (README.md)."""
        super()._save_pretrained(save_directory, **kwargs)
        parent = Path(save_directory).parent  # lerobot-train's `checkpoints/<step>/pretrained_model`
        checkpoint = parent.name.isdecimal() and parent.parent.name == "checkpoints"
        card = self._card(int(parent.name) if checkpoint else None, None)
        card.save(Path(save_directory) / "README.md")

    def generate_model_card(self, *args, cfg=None, **kwargs) -> ModelCard:
        """The card that LeRobot pushes to the Hub with the weights; `cfg` is the TrainPipelineConfig."""
        return self._card(None, cfg)

    def _card(self, steps, train) -> ModelCard:
        rest = None
        if self.encoder is not None and not self.encoder.rest_image.isnan().any():
            rest = tuple((255 * self.encoder.rest_image.mean((1, 2))).tolist())
        limits = self._action_low.tolist(), self._action_high.tolist()
        return model_card(self.config, self._demonstrations, rest, steps, train, limits)

    def get_optim_params(self):
        return self.parameters()

    def reset(self) -> None:
        """Forgets the previous action and all before; to be called when an episode starts."""
        self._previous: Tensor | None = None
        self._memory: memory.Memory | None = None

    # ------------------------------------------------------------ training

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """The paper's loss: mean of |1000 (dx - dx*)|^2 (mm^2 per step) plus mean of |p - p*|^2 (kPa^2).

        With `huber_delta` d an error e counts e^2 up to d and d (2 |e| - d) beyond (Huber 1964).

        Args:
            batch: `action` (B, 2, 3 + C) of C chambers, the previous and the present one; `action_is_pad`
                (B, 2), true where there is none; with `previous_action_in_data` instead `action` (B, 3 + C)
                and `observation.previous_action` (B, 3 + C); `observation.state` (B, 2 N + 5 + C) with N
                joints; the tactile image (B, 3, H, W) in [0, 1]; with memory `index` (B,), of the frames in
                the dataset that the policy was made for.

        Returns:
            loss, and its two terms by name.

        Raises InputError: the loss is not finite, or there is no dataset to remember.
        """
        recalled = self._memories[self._rows(batch)] if self.config.memory else None
        if self.config.previous_action_in_data:
            previous, target = batch[PREVIOUS_ACTION], batch[ACTION]
            hidden = torch.zeros(len(target), dtype=torch.bool, device=target.device)
        else:
            previous, target = batch[ACTION].unbind(1)
            hidden = batch[f"{ACTION}_is_pad"][:, 0]
        if self.config.answer_delay:
            rows = self._rows(batch)
            target = self._labels[rows]
            unknown = hidden | self._first[rows]
            previous = torch.where(unknown[:, None], previous, self._before[rows])
        return self.loss(batch[OBS_STATE], previous, hidden, target, self._difference(batch), recalled)

    def _rows(self, batch: dict[str, Tensor]) -> Tensor:
        """The frames of a batch in the dataset."""
        if "index" not in batch or (self._memories is None and self._labels is None):
            raise InputError(
                "With memory or an answer delay pneutac_bc needs the dataset that it is trained on"
                " (dataset_meta) and each frame's 'index'; train with lerobot-train, or give"
                " --policy.memory=false and --policy.answer_delay=0."
            )
        return batch["index"]

    def loss(
        self,
        state: Tensor,
        previous: Tensor,
        hidden: Tensor,
        target: Tensor,
        difference: Tensor | None,
        recalled: Tensor | None,
    ) -> tuple[Tensor, dict[str, float]]:
        """What `forward` returns, of samples whose images are prepared.

        Args:
            state: (B, 2 N + 5 + C).
            previous: action (B, 3 + C) of the frame before.
            hidden: (B,), true where there is none.
            target: action (B, 3 + C) to be learnt.
            difference: (B, 3, 80, 60) from `TactileEncoder.difference`; None without touch.
            recalled: (B, M) from `Memory.recall`; None without memory.
        """
        if self.training:
            state = state.clone()
            pressure = state[:, self._places.pressure]
            pressure += self.config.pressure_noise_kpa * torch.randn_like(pressure)
            drawn = torch.rand(len(hidden), device=hidden.device)
            hidden = hidden | (drawn < self.config.previous_action_dropout)
            if difference is not None:
                drift = self.config.brightness_noise_levels * torch.randn_like(difference[:, :, :1, :1])
                grain = self.config.pixel_noise_levels * torch.rand_like(difference[:, :1, :1, :1])
                noise = drift + grain * torch.randn(difference.shape, device=difference.device)
                difference = difference + noise / (255 * DIFFERENCE_SCALE)
        previous = torch.where(hidden[:, None], self._hold(state), previous)
        error = self._predict(state, difference, previous, recalled) - target
        # Velocity m/s to displacement per step mm.
        motion = self._penalty(error[..., :3] * (1000 / self.config.control_hz))
        pressure = self._penalty(error[..., PRESSURES])
        loss = motion + pressure
        if not loss.isfinite():
            raise InputError(
                "The loss is not finite: the dataset contains NaN, or the learning rate is too high."
            )
        return loss, {"motion_mm2": motion.item(), "pressure_kpa2": pressure.item()}

    def _penalty(self, error: Tensor) -> Tensor:
        """Mean over samples of what the errors count, see `forward`."""
        delta = self.config.huber_delta
        square = 2 * huber_loss(error, torch.zeros_like(error), "none", delta) if delta else error.square()
        return square.sum(-1).mean()

    # ------------------------------------------------------------ inference

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs) -> Tensor:
        """The next action (B, 3 + C), within the action limits; remembered with the observation.

        Raises InputError: an observation is not finite or has another shape, or there is no rest image.
        """
        self._previous = self.predict_action_chunk(batch)[:, 0]
        if self._memory is not None:
            self._memory.keep(batch[OBS_STATE])
        return self._previous

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs) -> Tensor:
        """The next action as a chunk of one, (B, 1, 3 + C); remembers nothing."""
        self.eval()
        state = batch[OBS_STATE]
        size = len(state_names(self.config.joints, self.config.chambers))
        if state.shape[1:] != (size,):
            raise InputError(f"The state has the shape {tuple(state.shape[1:])}; it must be ({size},).")
        previous = self._hold(state) if self._previous is None else self._previous
        if self.config.memory and self._memory is None:
            self._memory = memory.Memory(self.config.chambers, self.config.control_hz)
        recalled = self._memory.recall(state) if self._memory else None
        action = self._predict(state, self._difference(batch), previous, recalled).mean(0)
        if not action.isfinite().all():
            raise InputError("The policy's action is not finite: its weights or an observation contain NaN.")
        return action.clamp(self._action_low, self._action_high)[:, None]

    # ------------------------------------------------------------ network

    def _hold(self, state: Tensor) -> Tensor:
        """The action (B, 3 + C) that holds still: no velocity, and the pressures that there are."""
        hold = torch.zeros(len(state), len(action_names(self.config.chambers)), device=state.device)
        hold[:, PRESSURES] = state[:, self._places.pressure]
        return hold

    def _difference(self, batch: dict[str, Tensor]) -> Tensor | None:
        """What the tactile images of a batch show beyond the rest image; None without touch."""
        if self.encoder is None:
            return None
        if batch.get(TACTILE) is None:
            raise InputError(f"The observation has no '{TACTILE}'; pneutac_bc was trained with touch.")
        return self.encoder.difference(batch[TACTILE])

    def _predict(
        self, state: Tensor, difference: Tensor | None, previous: Tensor, recalled: Tensor | None
    ) -> Tensor:
        """Actions (networks, B, 3 + C), m/s and kPa, not clipped; see `loss`."""
        parts = [
            ((state - self._state_centre) / self._state_scale)[:, self._channels],
            (previous - self._action_centre) / self._action_scale,
        ]
        if recalled is not None:
            kpa = self._state_scale[self._places.pressure]
            parts.append(memory.scaled(recalled, kpa)[:, self._recalled])
        inputs = [torch.cat(parts, 1)] * self.config.networks
        if self.encoder is not None:
            difference = difference.contiguous(memory_format=torch.channels_last)  # faster on a CPU
            size = difference.abs()
            touch = [self.encoder(difference), *(other["layers"](size) for other in self.others)]
            inputs = [torch.cat(both, 1) for both in zip(touch, inputs, strict=True)]
        out = [mlp(x) for mlp, x in zip((self.mlp, *(o["mlp"] for o in self.others)), inputs, strict=True)]
        return torch.stack(out) * self._action_scale + self._action_centre
