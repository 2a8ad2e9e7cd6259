"""The policy `pneutac_bc`: |tactile - rest| through a convolutional encoder, with the state into an MLP.

The paper's policy network and loss (Sec. "Policy training"): a 64-D embedding of the tactile difference
with a 24-D observation {q, q', x, s/N, log(1+s), p, a_(t-1)}, two hidden layers of 256, 4-D action.
"""

from pathlib import Path

import torch
from huggingface_hub import ModelCard
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_STATE
from safetensors import safe_open
from torch import Tensor, nn

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PREVIOUS_ACTION, TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.model_card import Demonstrations, checkpoint_step, model_card
from lerobot_robot_pneutac.policy.rest_image import check_same_sensor, rest_image_of
from lerobot_robot_pneutac.policy.scaling import Scaling
from lerobot_robot_pneutac.policy.tactile_encoder import DIFFERENCE_SCALE, EMBEDDING, TactileEncoder
from pneutac_sim.errors import InputError
from pneutac_sim.features import CONTROL_HZ, PRESSURES, Places, action_names, state_names

HIDDEN = 256
REST = "encoder.rest_image"
SCALES = "_state_centre", "_action_centre"  # as long as state and action


class PneutacBCPolicy(PreTrainedPolicy):
    """Behaviour cloning from touch and proprioception; keeps its own previous action between calls.

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

        Raises:
            InputError: features or dataset do not fit.
        """
        super().__init__(config)
        self._dataset_rest = self._demonstrations = None
        if dataset_meta is not None:
            config.check_dataset(dataset_meta)
        config.control_hz = config.control_hz or CONTROL_HZ
        config.validate_features()
        if dataset_meta is not None:
            self._demonstrations = Demonstrations.of(dataset_meta)
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
        width = len(channels) + actions + (EMBEDDING if config.use_tactile else 0)
        self.mlp = nn.Sequential(
            nn.Linear(width, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, actions),
        )
        self._take_dataset_rest()
        self.reset()

    @classmethod
    def _load_as_safetensor(cls, model, model_file, map_location, strict):
        """Loads weights; a rest image from the present dataset outlives the one in the file.

        Raises:
            InputError: the file lacks weights or holds others, those of another body, or the two rest images
                cannot be of the same kind of sensor.
        """
        with safe_open(model_file, "pt") as file:
            if model.encoder is not None and REST in file.keys():
                model.config.check_size(tuple(file.get_slice(REST).get_shape()), str(model_file))
            other = sorted(set(file.keys()) ^ set(model.state_dict()))
            sizes = [file.get_slice(k).get_shape()[0] for k in SCALES if k in file.keys()]
        if other:
            raise InputError(
                f"'{model_file}' does not hold the weights of this policy (differs in {', '.join(other)});"
                " its use_tactile was another, or another version trained it: train again."
            )
        now = [len(model.state_dict()[k]) for k in SCALES]
        if sizes != now:
            raise InputError(
                f"'{model_file}' was trained on {sizes[0]} numbers of state and {sizes[1]} of action, and"
                f" here are {now[0]} and {now[1]}: an arm of other joints, or other chambers. Give those of"
                " its demonstrations (--env.twin, --env.station), or train again."
            )
        model = super()._load_as_safetensor(model, model_file, map_location, strict)
        if model._dataset_scaling is not None:
            model._reach(model._dataset_scaling)
        if model._dataset_rest is not None:
            check_same_sensor(model.encoder.rest_image, model._dataset_rest, model._demonstrations.name)
            model._take_dataset_rest()
        return model

    def learn_from(self, demonstrations: Demonstrations, rest: Tensor | None) -> None:
        """Takes another dataset's rest image (3, H, W), None without touch, and its name for the card.

        Raises:
            InputError: the rest image cannot be of the kind of sensor that the policy knows.
        """
        if self.encoder is not None:
            check_same_sensor(self.encoder.rest_image, rest, demonstrations.name)
        self._demonstrations, self._dataset_rest = demonstrations, rest if self.encoder is not None else None
        self._take_dataset_rest()

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
        self._card(checkpoint_step(Path(save_directory)), None).save(Path(save_directory) / "README.md")

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
        """Forgets the previous action; to be called when an episode starts."""
        self._previous: Tensor | None = None

    # ------------------------------------------------------------ training

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """The paper's loss: mean of |1000 (dx - dx*)|^2 (mm^2 per step) plus mean of |p - p*|^2 (kPa^2).

        Args:
            batch: `action` (B, 2, 3 + C) of C chambers, the previous and the present one; `action_is_pad`
                (B, 2), true where there is none; with `previous_action_in_data` instead `action` (B, 3 + C)
                and `observation.previous_action` (B, 3 + C); `observation.state` (B, 2 N + 5 + C) with N
                joints; the tactile image (B, 3, H, W) in [0, 1].

        Returns:
            loss, and its two terms by name.

        Raises:
            InputError: the loss is not finite.
        """
        if self.config.previous_action_in_data:
            previous, target = batch[PREVIOUS_ACTION], batch[ACTION]
            hidden = torch.zeros(len(target), dtype=torch.bool, device=target.device)
        else:
            previous, target = batch[ACTION].unbind(1)
            hidden = batch[f"{ACTION}_is_pad"][:, 0]
        return self.loss(batch[OBS_STATE], previous, hidden, target, self._difference(batch))

    def loss(
        self, state: Tensor, previous: Tensor, hidden: Tensor, target: Tensor, difference: Tensor | None
    ) -> tuple[Tensor, dict[str, float]]:
        """What `forward` returns, of samples whose images are prepared.

        Args:
            state: (B, 2 N + 5 + C).
            previous: action (B, 3 + C) of the frame before.
            hidden: (B,), true where there is none.
            target: action (B, 3 + C) to be learnt.
            difference: (B, 3, 80, 60) from `TactileEncoder.difference`; None without touch.
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
        error = self._predict(state, difference, previous) - target
        # Velocity m/s to displacement per step mm.
        motion = (error[:, :3] * (1000 / self.config.control_hz)).square().sum(1).mean()
        pressure = error[:, PRESSURES].square().sum(1).mean()
        loss = motion + pressure
        if not loss.isfinite():
            raise InputError(
                "The loss is not finite: the dataset contains NaN, or the learning rate is too high."
            )
        return loss, {"motion_mm2": motion.item(), "pressure_kpa2": pressure.item()}

    # ------------------------------------------------------------ inference

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs) -> Tensor:
        """The next action (B, 3 + C), within the action limits; remembered as the previous one.

        Raises:
            InputError: an observation is not finite or has another shape, or there is no rest image.
        """
        self._previous = self.predict_action_chunk(batch)[:, 0]
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
        action = self._predict(state, self._difference(batch), previous)
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

    def _predict(self, state: Tensor, difference: Tensor | None, previous: Tensor) -> Tensor:
        """Action (B, 3 + C), m/s and kPa, not clipped, from state, difference and previous action."""
        parts = [
            ((state - self._state_centre) / self._state_scale)[:, self._channels],
            (previous - self._action_centre) / self._action_scale,
        ]
        if self.encoder is not None:
            parts.insert(0, self.encoder(difference))
        return self.mlp(torch.cat(parts, 1)) * self._action_scale + self._action_centre
