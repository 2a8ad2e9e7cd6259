"""The model card of a `pneutac_bc` checkpoint: its README.md, for whoever finds the weights alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from huggingface_hub import ModelCard, ModelCardData
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, action_names, pressure_names, state_names

_STATE_UNITS = {
    "contact_area.pos": "share of the image's pixels that are in contact",
    "contact_pixels.pos": "log(1 + pixels in contact)",
}


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
        """Reads them from a LeRobotDatasetMetadata."""
        return cls((meta.repo_id,), meta.total_episodes, meta.total_frames, tuple(map(str, meta.tasks.index)))

    @property
    def name(self) -> str:
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
    limits: tuple[Sequence[float], Sequence[float]] = (ACTION_LOW, ACTION_HIGH),
) -> ModelCard:
    """The card of one checkpoint.

    Args:
        config: the policy's options.
        demonstrations: the training data, where known.
        rest_level: mean of the rest image's channels R, G, B, of 255; None where there is none.
        steps: training steps, where known.
        train: options of the whole training, where known.
        limits: lowest and highest action (3 + C,).

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
    # A folder of this machine says nothing elsewhere, and a resumed training names its own checkpoint.
    known = config.pretrained_path and not Path(config.pretrained_path).is_dir()
    level = rest_level if config.use_tactile else None
    return ModelCard.from_template(
        data,
        template_path=str(Path(__file__).with_name("model_card_template.md")),
        config=config,
        data=demonstrations,
        steps=train.steps if steps is None and train is not None else steps,
        batch_size=None if train is None else train.batch_size,
        fine_tuned_from=Path(config.pretrained_path).as_posix() if known else None,
        features=_features(config, limits),
        rest_level=None if level is None else ", ".join(f"{v:.0f}" for v in level),
    )


def _features(
    config: PneutacBCConfig, limits: tuple[Sequence[float], Sequence[float]]
) -> list[tuple[str, str, str]]:
    """Feature, name or shape, and unit of all that goes in or comes out."""
    pressures = pressure_names(config.chambers)

    def unit(name: str) -> str:
        if name.startswith("joint"):
            return "rad" if name.endswith(".pos") else "rad/s"
        return "kPa" if name in pressures else _STATE_UNITS.get(name, "m")

    unused = () if config.use_tactile else ("contact_area.pos", "contact_pixels.pos")
    rows = [
        (OBS_STATE, f"`{n}`", unit(n) + (" (not looked at)" if n in unused else ""))
        for n in state_names(config.joints, config.chambers)
    ]
    if config.use_tactile:
        c, h, w = config.image_shape
        rows.append((TACTILE, f"{w} x {h} pixels, {c} channels, RGB", "0 to 1"))
    return rows + [
        (ACTION, f"`{n}`", f"{'kPa' if n in pressures else 'm/s'}, {low:g} to {high:g}")
        for n, low, high in zip(action_names(config.chambers), *limits, strict=True)
    ]
