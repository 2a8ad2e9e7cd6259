"""Recovers all finished episodes of a dataset whose recording was interrupted."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_pneutac.cli.terminal import Terminal
from pneutac_sim.errors import InputError


@dataclass
class RepairConfig:
    """Options of `pneutac repair`."""

    dataset: Path  # folder of the dataset; nothing else may be writing there
    # folder of an intact dataset of the same robot and frame rate, needed only if info.json is damaged
    like: Path | None = None
    drop: bool = False  # leave out episodes whose videos are missing; their files move to the folder left_out


def command(config: RepairConfig, terminal: Terminal) -> None:
    if not config.dataset.is_dir():  # before imports that take seconds
        raise InputError(f"There is no folder '{config.dataset}'; give the folder of a dataset.")
    if config.like is not None and not (config.like / "meta" / "info.json").is_file():
        raise InputError(
            f"like={config.like} is no dataset of LeRobot (no meta/info.json); give a whole one."
        )
    from pneutac_datasets.demonstrations.repair import repair_dataset

    repaired = repair_dataset(config.dataset, config.like, config.drop)
    for remark in repaired.remarks:
        terminal.say(remark)
    count = f"{repaired.episodes} episodes, {repaired.recovered} of them recovered"
    terminal.say(f"\n{config.dataset} is complete: {count}.", style="bold")
