"""`pneutac add`: switches effects on in a twin, re-fits all, and stores that if the test error falls.

Nothing is stored where the fall is not significant, see `lerobot_pneutac.verbs.add`.
"""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import TableOptions, parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.study.pair import load_pair
from lerobot_pneutac.verbs.add import add
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.files import check_writable


@dataclass
class AddConfig(TableOptions):
    """Options of `pneutac add`.

    Attributes:
        twin: folder of the twin; its next version is written there if the test error falls significantly.
        recording: folder of a bench recording, or tables as `pneutac convert` reads them of the same finger,
            arm or gel; or of a LeRobotDataset of demonstrations, or its name on the Hub.
        effect: names of the effects or laws to switch on, joined by commas.
        diagnosis: folder that `pneutac diagnose` wrote; all that it found is switched on. Also `--from`.
        task: of demonstrations: what stood in front of the robot, where their instruction does not tell.
        station: of demonstrations: `station.yaml` of the arm and its place; left out, the one that their
            robot left in them, or the paper's.
        anyway: stores the version although the error does not fall significantly, marked as unconfirmed.
        out: folder for `result.json` and `report.html`.
        seed: seed of the choice of what is held out, and of the bootstrap.
    """

    twin: Path
    recording: Path
    effect: str = ""
    diagnosis: Path | None = None
    task: str = ""
    station: Path | None = None
    anyway: bool = False
    out: Path | None = None
    seed: int = 0

    def __post_init__(self):
        if bool(self.effect) == (self.diagnosis is not None):
            raise InputError(
                "Give the effects with --effect=A,B, or all that a diagnosis found with --from=DIR; "
                "`pneutac diagnose --out=DIR` tells what is missing."
            )


def main(argv: list[str]) -> None:
    """Runs the verb."""
    given = [f"--diagnosis={a[7:]}" if a.startswith("--from=") else a for a in argv]
    cfg, console = parse_options(AddConfig, given), Console()
    effects = [e.strip() for e in cfg.effect.split(",")] if cfg.effect else []
    for e in effects:
        get_effect(e)
    twin, recording = load_pair(cfg.twin, cfg.recording, "add to", cfg.task, cfg.station)
    check_writable(cfg.twin, f"--twin={cfg.twin}")
    with progress_bar(Console(stderr=True)) as progress:
        result = add(
            twin, recording, cfg.diagnosis or effects, seed=cfg.seed, anyway=cfg.anyway, progress=progress
        )
    if result.accepted or result.unconfirmed:
        result = result.save(cfg.twin)
    finish(result, console, cfg.out, "add", argv, sentence=result.accepted or result.unconfirmed)
    if not (result.accepted or result.unconfirmed):
        raise InputError(result.reason)
