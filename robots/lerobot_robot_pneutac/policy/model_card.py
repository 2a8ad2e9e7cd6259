"""The model card of a `pneutac_bc` checkpoint: its README.md, for whoever finds the weights alone."""

from dataclasses import dataclass
from pathlib import Path

from huggingface_hub import ModelCard, ModelCardData
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, ACTION_NAMES, IMAGE_SHAPE, STATE_NAMES

_STATE_UNITS = {
    "contact_area.pos": "share of the image's pixels that are in contact",
    "contact_pixels.pos": "log(1 + pixels in contact)",
    "pressure.pos": "kPa",
}
_ACTION_UNITS = {"pressure.pos": "kPa"}


@dataclass(frozen=True)
class Demonstrations:
    """What a card says about the data that a policy was trained on.

    Attributes:
        repo_ids: of the dataset, or of several that were read as one.
        episodes: their number.
        frames: their number.
        tasks: instructions stored with the frames.
    """

    repo_ids: tuple[str, ...]
    episodes: int
    frames: int
    tasks: tuple[str, ...]

    @classmethod
    def of(cls, meta) -> "Demonstrations":
        """Those of a LeRobotDatasetMetadata."""
        return cls((meta.repo_id,), meta.total_episodes, meta.total_frames, tuple(map(str, meta.tasks.index)))

    @property
    def name(self) -> str:
        """For sentences."""
        return ", ".join(self.repo_ids)


def checkpoint_step(folder: Path) -> int | None:
    """Training steps of a checkpoint of lerobot-train, `checkpoints/<step>/pretrained_model`, else None."""
    step = folder.parent.name
    return int(step) if step.isdecimal() and folder.parent.parent.name == "checkpoints" else None


def model_card(
    config: PneutacBCConfig,
    demonstrations: Demonstrations | None = None,
    rest_level: tuple[float, float, float] | None = None,
    steps: int | None = None,
    train: TrainPipelineConfig | None = None,
) -> ModelCard:
    """The card of one checkpoint.

    Args:
        config: the policy's options.
        demonstrations: the training data, where known.
        rest_level: mean of the rest image's channels R, G, B, of 255; None where there is none.
        steps: training steps, where known.
        train: options of the whole training, where known.

    Returns:
        The card; `save` writes it.
    """
    data = ModelCardData(
        license=config.license or "apache-2.0",
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=sorted({*(config.tags or []), "lerobot", "robotics", config.type}),
        model_name=config.type,
        datasets=list(demonstrations.repo_ids) if demonstrations else None,
    )
    sections = (
        _summary(config),
        _training(config, demonstrations, steps, train),
        _features(config),
        _rest(config, demonstrations, rest_level),
        _use(config, demonstrations),
        _limits(config),
        f"## Licence\n\n`{data.license}`",
    )
    return ModelCard(f"---\n{data.to_yaml()}\n---\n\n" + "\n\n".join(s for s in sections if s) + "\n")


def _summary(config: PneutacBCConfig) -> str:
    senses = "touch and proprioception" if config.use_tactile else "proprioception alone, without touch"
    return (
        f"# {config.type}\n\nBehaviour cloning from {senses}, for a Franka Panda with a soft pneumatic finger"
        " and a DIGIT at its tip. A convolutional encoder of |tactile image - rest image| (only with touch)"
        " and a perceptron of two hidden layers; one action at a time. State and action are scaled by fixed"
        " physical ranges inside the network. Needs the LeRobot plugin `lerobot_robot_pneutac`."
    )


def _training(
    config: PneutacBCConfig,
    data: Demonstrations | None,
    steps: int | None,
    train: TrainPipelineConfig | None,
) -> str:
    lines = []
    if data:
        names = ", ".join(f"`{name}`" for name in data.repo_ids)
        lines.append(f"- Data: {names}, {data.episodes} episodes, {data.frames} frames")
        lines += [f"- Task: {task}" for task in data.tasks]
    else:
        lines.append("- Data: not known where these weights were saved")
    if steps is None and train is not None:
        steps = train.steps
    if steps is not None:
        lines.append(f"- Steps: {steps}")
    if train is not None:
        lines.append(f"- Batch size: {train.batch_size}")
    # A folder of this machine says nothing elsewhere, and a resumed training names its own checkpoint.
    if config.pretrained_path and not Path(config.pretrained_path).is_dir():
        lines.append(f"- Fine-tuned from: `{Path(config.pretrained_path).as_posix()}`")
    lines.append(
        "- Loss: squared error of displacement (mm^2) and pressure (kPa^2), Adam, lr"
        f" {config.optimizer_lr:g} falling to 0 along a cosine"
    )
    return "## Training\n\n" + "\n".join(lines)


def _features(config: PneutacBCConfig) -> str:
    def unit(name: str) -> str:
        if name.startswith("joint"):
            return "rad" if name.endswith(".pos") else "rad/s"
        return _STATE_UNITS.get(name, "m")

    h, w, c = IMAGE_SHAPE
    unused = () if config.use_tactile else ("contact_area.pos", "contact_pixels.pos")
    rows = [
        f"| `{OBS_STATE}` | `{n}` | {unit(n)}{' (not looked at)' if n in unused else ''} |"
        for n in STATE_NAMES
    ]
    if config.use_tactile:
        rows.append(f"| `{TACTILE}` | {w} x {h} pixels, {c} channels, RGB | 0 to 1 |")
    rows += [
        f"| `{ACTION}` | `{n}` | {_ACTION_UNITS.get(n, 'm/s')}, {low:g} to {high:g} |"
        for n, low, high in zip(ACTION_NAMES, ACTION_LOW, ACTION_HIGH, strict=True)
    ]
    return (
        f"## Observation and action\n\nControl rate: {config.control_hz} Hz. Velocities are of the end"
        " effector, its orientation is held.\n\n| feature | name | unit |\n|---|---|---|\n" + "\n".join(rows)
    )


def _rest(config: PneutacBCConfig, data: Demonstrations | None, level: tuple[float, ...] | None) -> str:
    if not config.use_tactile or level is None:
        return ""
    source = f"of `{data.name}`" if data else "of the training data"
    return (
        f"## Rest image\n\nThe weights carry the tactile image out of contact, the median of the first"
        f" frames {source} (mean R, G, B: {', '.join(f'{v:.0f}' for v in level)} of 255). Another DIGIT"
        " needs its own: fine-tune, and it is taken from the new demonstrations."
    )


def _use(config: PneutacBCConfig, data: Demonstrations | None) -> str:
    task = data.tasks[0] if data and data.tasks else "what to do"
    return f"""## Use

`THIS` is this folder or its name on the Hub.

```bash
lerobot-eval --policy.path=THIS --env.type=pneutac --env.task=switch --eval.n_episodes=10

lerobot-rollout --strategy.type=base --policy.path=THIS --robot.type=pneutac_sim --robot.id=twin \\
  --fps={config.control_hz} --task="{task}" --duration=20

lerobot-train --policy.path=THIS --policy.optimizer_lr=3e-5 --dataset.repo_id=YOU/YOUR_DEMONSTRATIONS \\
  --output_dir=outputs/fine_tuned --steps=500
```"""


def _limits(config: PneutacBCConfig) -> str:
    lines = [
        "- No run on hardware has been recorded for this card. On a robot, begin slowly and within reach of"
        " the emergency stop.",
        "- It imitates its demonstrations and knows no other task, object or workspace.",
        f"- It expects {config.control_hz} Hz; at another rate its velocities mean other displacements.",
    ]
    if config.use_tactile:
        lines.append(
            "- The sensor's images must be as in the demonstrations: not mirrored, no channels swapped."
        )
    return "## Limits\n\n" + "\n".join(lines)
