"""`pneutac diagnose`: finds the physical effect that a twin lacks, its rivals and the next experiment."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import TableOptions, parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.study.pair import load_pair
from lerobot_pneutac.verbs.contenders import save_contenders
from lerobot_pneutac.verbs.diagnose import diagnose


@dataclass
class DiagnoseConfig(TableOptions):
    """Options of `pneutac diagnose`.

    Attributes:
        twin: folder of the twin, which is not changed.
        recording: folder of a bench recording, or tables as `pneutac convert` reads them of the same finger,
            arm or gel; or of a LeRobotDataset of demonstrations, or its name on the Hub.
        task: of demonstrations: what stood in front of the robot, where their instruction does not tell.
        station: of demonstrations: `station.yaml` of the arm and its place; left out, the one that their
            robot left in them, or the paper's.
        out: folder for `result.json` and `report.html`.
        jobs: number of processes; 0 for all cores.
        seed: seed of the choice of what is held out, and of every bootstrap.
    """

    twin: Path
    recording: Path
    task: str = ""
    station: Path | None = None
    out: Path | None = None
    jobs: int = 0
    seed: int = 0


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(DiagnoseConfig, argv), Console()
    twin, recording = load_pair(cfg.twin, cfg.recording, "diagnose", cfg.task, cfg.station)
    with progress_bar(Console(stderr=True)) as progress:
        result = diagnose(twin, recording, jobs=cfg.jobs, seed=cfg.seed, progress=progress)
    if cfg.out is not None and recording.device != "gel":
        result = result.save(cfg.out)
    elif cfg.out is not None:
        save_contenders(cfg.out, result.outcome.contenders)
    finish(result, console, cfg.out, "diagnose", argv)
