"""Makes a dataset whole whose recording was killed, with all finished episodes."""

from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape

from lerobot_pneutac.cli.terminal import Terminal


@dataclass
class RepairConfig:
    """Options of `pneutac repair`.

    Attributes:
        dataset: folder of the dataset; nothing else may be writing there.
        like: folder of a whole dataset of the same robot and frame rate, wanted only where info.json is torn.
        drop: leave out episodes whose videos are missing; their numbers move to the folder left_out.
    """

    dataset: Path
    like: Path | None = None
    drop: bool = False


def command(config: RepairConfig, terminal: Terminal) -> None:
    """Makes a dataset whole whose recording was killed, with all finished episodes."""
    from pneutac_datasets.demonstrations.repair.dataset import repair_dataset

    repaired = repair_dataset(config.dataset, config.like, config.drop)
    for remark in repaired.remarks:
        terminal.console.print(escape(remark), highlight=False)
    terminal.console.print(
        f"\n[bold]{escape(str(config.dataset))} is whole: {repaired.episodes} episodes,"
        f" {repaired.recovered} of them recovered.[/]",
        highlight=False,
    )
