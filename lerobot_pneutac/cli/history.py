"""`pneutac history`: lists the versions of a twin, and goes back to one of them."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.show import show
from lerobot_pneutac.verbs.history import restore
from lerobot_pneutac.verbs.report import report
from pneutac_sim.twin import Twin


@dataclass
class HistoryConfig:
    """Options of `pneutac history`.

    Attributes:
        twin: folder of the twin.
        restore: number of the version to go back to; it is written as the newest one, and nothing is lost.
    """

    twin: Path
    restore: int | None = None


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(HistoryConfig, argv), Console()
    twin = Twin.load(cfg.twin) if cfg.restore is None else restore(cfg.twin, cfg.restore)
    show(report(twin), console)
    if cfg.restore is not None:
        number = twin.history[-1]["version"]
        console.print(
            f"wrote version {number} of {cfg.twin}, equal to version {cfg.restore}", highlight=False
        )
