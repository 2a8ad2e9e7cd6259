"""`pneutac add`: switches an effect on in a twin, re-fits everything, shows the error before and after."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import check_given, check_out, show, write
from lerobot_pneutac.study.pair import load_pair
from lerobot_pneutac.verbs.add import add
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError


@dataclass
class AddConfig:
    """Options of `pneutac add`.

    Attributes:
        twin: the twin's folder; its next version is written there if the error falls.
        recording: a bench recording of the same finger, arm or gel.
        effect: name of the effect to switch on.
        out: folder for `result.json` and `report.html`.
        seed: decides which blocks of time are held out, and the bootstrap.
    """

    twin: Path | None = None
    recording: Path | None = None
    effect: str = ""
    out: Path | None = None
    seed: int = 0

    def __post_init__(self):
        check_given(self, "twin", "recording")
        if not self.effect:
            raise InputError(
                "Give the effect with --effect=NAME; `pneutac diagnose` tells which one is missing."
            )
        check_out(self.out)


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(AddConfig, argv), Console()
    get_effect(cfg.effect)
    twin, recording = load_pair(cfg.twin, cfg.recording, "add to")
    with progress_bar(console) as progress:
        result = add(twin, recording, cfg.effect, seed=cfg.seed, progress=progress)
    if result.accepted:
        result = result.save(cfg.twin)
    show(result, console, sentence=result.accepted)
    write(result, cfg.out, "add", argv, console)
    if not result.accepted:
        raise InputError(result.reason)
