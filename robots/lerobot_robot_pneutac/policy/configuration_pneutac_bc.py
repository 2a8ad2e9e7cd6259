"""Options of the policy `pneutac_bc`, and what it demands of a dataset."""

from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow.parquet as parquet
from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamConfig
from lerobot.optim.schedulers import CosineDecayWithWarmupSchedulerConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from lerobot_robot_pneutac.options import check_range, refuse_if
from pneutac_sim.dataset_files import Files
from pneutac_sim.errors import InputError
from pneutac_sim.features import (
    CHAMBERS,
    IMAGE_NAME,
    IMAGE_SHAPE,
    SPECKS,
    STATE_NAMES,
    VELOCITY_NAMES,
    action_names,
    chamber_count,
    joint_count,
    state_names_like,
)

# The network sees means over the cells of such a grid, lying where the image does, 4 x 4 pixels of a DIGIT's.
# A dataset may hold these means instead of images, and then says of what size these were.
POOLED_SHAPE = (80, 60, 3)
POOLED_FROM = "pooled_from"  # rows and columns, in the feature's `info`
MOST_STEPS = 10**9  # LeRobot fits the fall of the learning rate into the steps that there are
ANSWER_DELAY = "answer_delay_frames"  # in the `info` of a dataset's action
MOST_AHEAD_S = 0.2  # a label farther ahead is of another place
NETWORKS = 3  # on what the library made
MOST_NETWORKS = 100  # a typo beyond would fill the memory
HUBER_DELTA = 0.5  # mm a control step and kPa; a hand's tremor is 0.4 mm a step
TACTILE = f"{OBS_IMAGES}.{IMAGE_NAME}"
PREVIOUS_ACTION = "observation.previous_action"


@PreTrainedConfig.register_subclass("pneutac_bc")
@dataclass
class PneutacBCConfig(PreTrainedConfig):
    """Behaviour cloning from touch and proprioception, the paper's policy.

    State and action are scaled inside the network by the statistics of the first training's dataset and
    LeRobot's own normalisation is off, so that fine-tuning on other data never rescales what was learnt.
    """

    use_tactile: bool = True  # false leaves out the tactile image and both contact scalars
    # whether the policy remembers where and when it last touched, and what it sensed 0.5 and 1 s ago; if
    # omitted, a policy that is trained on a dataset does, and one that was before it could does not
    memory: bool | None = None
    # frames by which the demonstrator answers a touch late; labels in touch are taken so much ahead, at most
    # 0.2 s. If omitted, what `pneutac augment` wrote into the dataset, else 0.
    answer_delay: int | None = None
    # error in mm a control step and in kPa beyond which it counts in proportion and not by its square
    # (Huber's loss), so that a pause or a slip among many demonstrations weighs less; 0 is the paper's
    # squared loss. If omitted, 0.5 on a dataset that `pneutac augment --method=library` made, else 0.
    huber_delta: float | None = None
    # networks that are trained together from different initial weights; the action is the mean of theirs.
    # If omitted, three on a dataset that `pneutac augment --method=library` made, else one.
    networks: int | None = None
    # rate of the data and of the robot, which turns velocities into displacements per step; if omitted, the
    # first dataset's
    control_hz: int | None = None
    # share of training samples in which the previous action is hidden (replaced by holding still), lest the
    # policy copies its last action instead of looking
    previous_action_dropout: float = 0.3
    # whether the dataset itself holds the previous action, as `observation.previous_action`
    # (`pneutac_datasets.demonstrations.pool` writes it). Then LeRobot reads one row for a training sample and
    # not three, most of its work with small images.
    previous_action_in_data: bool = False
    # noise on the sensed pressure while training. The next pressure is nearly the present one; a policy that
    # copies it lets small errors add up, and the pressure drifts.
    pressure_noise_kpa: float = 0.75
    # noise on each colour's brightness while training, in levels of 8 bit, against what is left of a drift of
    # the light
    brightness_noise_levels: float = 3.0
    # noise on the pixels of |tactile - rest| (4 x 4 of the camera's in one) while training, up to so many
    # levels of 8 bit, another strength for each image. A simulator's image is exact, and a policy that was
    # trained on it alone reads a camera's noise as touch.
    pixel_noise_levels: float = 1.0
    # learning rate of Adam, where training begins; it falls to zero along a cosine
    optimizer_lr: float = 3e-4
    action_feature_names: list[str] | None = None  # set by LeRobot from the dataset
    # those of the dataset that it was trained on last; one that names another task than the environment's or
    # the robot's is refused there, unless they are set to null
    instructions: list[str] | None = None
    push_to_hub: bool = False
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("VISUAL", "STATE", "ACTION"), NormalizationMode.IDENTITY)
    )

    def __post_init__(self):
        super().__post_init__()
        check_range("--policy.previous_action_dropout", self.previous_action_dropout, 0, 1)
        check_range("--policy.networks", self.networks, 1, MOST_NETWORKS)
        noises = "pressure_noise_kpa", "brightness_noise_levels", "pixel_noise_levels"
        for name in ("answer_delay", "huber_delta", *noises):
            check_range(f"--policy.{name}", getattr(self, name), 0)
        check_range("--policy.optimizer_lr", self.optimizer_lr, 0, ends="()")
        check_range("--policy.control_hz", self.control_hz, 0, ends="()")
        refuse_if(
            any(mode is not NormalizationMode.IDENTITY for mode in self.normalization_mapping.values()),
            "--policy.normalization_mapping must be IDENTITY throughout; pneutac_bc scales by itself.",
        )

    @property
    def observation_delta_indices(self) -> None:
        return None

    @property
    def action_delta_indices(self) -> list[int] | None:
        """The previous action, an input, and the present one, the label."""
        return None if self.previous_action_in_data else [-1, 0]

    @property
    def reward_delta_indices(self) -> None:
        return None

    def get_optimizer_preset(self) -> AdamConfig:
        """Adam; the gradient is not clipped, its size is that of the loss in mm^2 and kPa^2."""
        return AdamConfig(lr=self.optimizer_lr, grad_clip_norm=0.0)

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Falls to zero with the last step: at a constant rate success differs from one step to another."""
        return CosineDecayWithWarmupSchedulerConfig(
            num_warmup_steps=0, num_decay_steps=MOST_STEPS, peak_lr=self.optimizer_lr, decay_lr=0.0
        )

    @property
    def joints(self) -> int:
        """Joints of the arm, by the size of the state; 0 where it is the state of none."""
        shape = self.input_features[OBS_STATE].shape if OBS_STATE in (self.input_features or {}) else ()
        return joint_count(shape[0], self.chambers) if len(shape) == 1 else 0

    @property
    def chambers(self) -> int:
        """Chambers of the finger, by the size of the action; one where it is that of none."""
        shape = self.output_features[ACTION].shape if ACTION in (self.output_features or {}) else ()
        chambers = shape[0] - len(VELOCITY_NAMES) if len(shape) == 1 else 1
        return chambers if chambers in CHAMBERS.values() else 1

    def validate_features(self) -> None:
        """Raises InputError where the shapes of state, action or tactile image do not fit."""
        inputs, outputs = self.input_features or {}, self.output_features or {}
        if not self.joints:  # of no arm
            _need_shape(inputs, OBS_STATE, (len(STATE_NAMES),))
        _need_shape(outputs, ACTION, (len(action_names(self.chambers)),))
        if self.use_tactile:
            if len(self.image_shape) != 3 or self.image_shape[0] != IMAGE_SHAPE[2]:
                _need_shape(inputs, TACTILE, (IMAGE_SHAPE[2], *IMAGE_SHAPE[:2]))
        # Other cameras, and without touch this one too, are not looked at; robots need not have them.
        used = (TACTILE,) if self.use_tactile else ()
        self.input_features = {
            k: f
            for k, f in inputs.items()
            if k != PREVIOUS_ACTION and (f.type is not FeatureType.VISUAL or k in used)
        }

    @property
    def image_shape(self) -> tuple[int, ...]:
        """Channels, height and width of the tactile image; () where there is none."""
        found = (self.input_features or {}).get(TACTILE)
        return () if found is None else tuple(found.shape)

    def check_size(self, shape: tuple[int, ...], where: str) -> None:
        """Raises InputError where tactile images (3, H, W) of a file or dataset are of another size."""
        if self.image_shape and shape != self.image_shape:
            raise InputError(
                f"{where}: the tactile images are {shape[2]} x {shape[1]} px and this policy takes"
                f" {self.image_shape[2]} x {self.image_shape[1]}; give the camera that width and height, or"
                " train again with --policy.type=pneutac_bc."
            )

    def check_dataset(self, meta) -> None:
        """Raises InputError where a dataset cannot train this policy.

        What the policy does not know yet it takes from the dataset: its rate, and the size of whole images.

        Args:
            meta: LeRobotDatasetMetadata.
        """
        where = f"Dataset '{meta.repo_id}'"
        if meta.total_episodes == 0:
            raise InputError(f"{where} has no episodes; record at least one.")
        self.control_hz = self.control_hz or meta.fps
        if meta.fps != self.control_hz:
            raise InputError(
                f"{where} has {meta.fps} frames per second and the policy's control_hz is {self.control_hz};"
                " they must be equal."
            )
        for key in (OBS_STATE, ACTION):
            found = (meta.features.get(key) or {}).get("names")
            like = found or []
            names = state_names_like(like) if key == OBS_STATE else action_names(chamber_count(like))
            if list(found or []) != list(names):
                raise InputError(f"{where}: '{key}' has the names {found}; pneutac_bc needs {list(names)}.")
            if not {"min", "max"} <= (meta.stats or {}).get(key, {}).keys():
                raise InputError(
                    f"{where} has no statistics of '{key}', which scale it; write them with"
                    " lerobot-edit-dataset --operation.type=recompute_stats."
                )
            extremes = [np.ravel(v) for k, v in meta.stats[key].items() if k in ("min", "max")]
            if bad := [n for i, n in enumerate(names) if not all(np.isfinite(e[i]) for e in extremes)]:
                Files(meta.root).refuse_not_finite()
                raise InputError(
                    f"{where}: meta/stats.json has NaN or infinity for '{key}' in {', '.join(bad)}, and"
                    " no frame has; write it with lerobot-edit-dataset --operation.type=recompute_stats."
                )
        if self.previous_action_in_data and PREVIOUS_ACTION not in meta.features:
            raise InputError(
                f"{where} has no '{PREVIOUS_ACTION}'; write it with pneutac_datasets.demonstrations.pool, or"
                " give --policy.previous_action_in_data=false."
            )
        info = meta.features[ACTION].get("info") or {}
        if self.answer_delay is None:
            self.answer_delay = info.get(ANSWER_DELAY, 0)
        if self.huber_delta is None:
            self.huber_delta = HUBER_DELTA if ANSWER_DELAY in info else 0.0
        if self.networks is None:
            self.networks = NETWORKS if ANSWER_DELAY in info else 1
        if self.use_tactile:
            if TACTILE not in meta.features:
                raise InputError(f"{where} has no '{TACTILE}'; record it, or use --policy.use_tactile=false.")
            found = tuple(meta.features[TACTILE]["shape"])
            if len(found) != 3 or found[2] != IMAGE_SHAPE[2]:
                raise InputError(
                    f"{where}: '{TACTILE}' has the shape {found}; pneutac_bc needs RGB such as {IMAGE_SHAPE}."
                )
            whole, stored = whole_shape(meta.features[TACTILE]), (found[2], *found[:2])
            if self.image_shape == stored != whole:  # robots give all pixels
                self.input_features = dict(self.input_features or {})
                self.input_features[TACTILE] = replace(self.input_features[TACTILE], shape=whole)
            self.check_size(whole, where)
            if untouched := _untouched(meta):
                which = ", ".join(map(str, untouched))
                raise InputError(
                    f"{where}: no touch in episode{'s' * (len(untouched) > 1)} {which} (contact_area.pos is 0"
                    " throughout), and the policy is to learn from touch; leave out with lerobot-edit-dataset"
                    f' --operation.type=delete_episodes --operation.episode_indices="{untouched}", or train'
                    " with --policy.use_tactile=false."
                )


def _untouched(meta) -> list[int]:
    """Episodes of a dataset without contact, isolated noise pixels left out."""
    from pneutac_sim.gel.contact import without_specks  # Numba, which robots do not need

    table = parquet.read_table(meta.root / "data", columns=["episode_index", OBS_STATE])
    state = np.array(table[OBS_STATE].to_pylist(), float)
    area = state[:, meta.features[OBS_STATE]["names"].index("contact_area.pos")]
    episode = table["episode_index"].to_numpy()
    return [int(e) for e in np.unique(episode) if not without_specks(area[episode == e]).any()]


def whole_shape(feature: dict) -> tuple[int, int, int]:
    """Shape (3, H, W) of the tactile images of which a dataset's feature holds means, or its own."""
    rows, columns, channels = feature["shape"]
    if (rows, columns, channels) == POOLED_SHAPE:  # before 0.2 a DIGIT's, without a word
        rows, columns, _ = IMAGE_SHAPE
    rows, columns = (feature.get("info") or {}).get(POOLED_FROM, (rows, columns))
    return channels, rows, columns


def _need_shape(features: dict, key: str, shape: tuple[int, ...]) -> None:
    found = tuple(features[key].shape) if key in features else None
    if found != shape:
        hint = "; without it use --policy.use_tactile=false" if key == TACTILE else ""
        raise InputError(f"Feature '{key}' has the shape {found}; pneutac_bc needs {shape}{hint}.")


def frames_ahead(delay: int, control_hz: int) -> int:
    """Frames by which labels are taken ahead for a delay in frames.

    A person moves 0.2 to 0.4 s after the touch that is answered, and who answers late teaches a policy to
    answer late, too. It need not wait: its label in touch is what was done that much later.
    """
    return min(delay, round(MOST_AHEAD_S * control_hz))


def ahead(action: np.ndarray, area: np.ndarray, episode: np.ndarray, frames: int) -> np.ndarray:
    """Actions (F, 3 + C) whose labels in touch, and for as many frames after it, are those so many frames on.

    Contact areas `area` and numbers of the episodes are (F,); labels stay within their episode.
    """
    moved = action.copy()
    for k in np.unique(episode):
        rows = np.flatnonzero(episode == k)
        touch = area[rows] >= SPECKS
        near = np.convolve(touch, np.ones(frames + 1), "full")[: len(rows)] > 0
        later = rows[np.minimum(np.arange(len(rows)) + frames, len(rows) - 1)]
        moved[rows[near]] = action[later[near]]
    return moved
