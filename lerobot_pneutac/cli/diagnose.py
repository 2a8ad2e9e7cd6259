"""`pneutac diagnose`: which physical effect a twin lacks, with rivals, intervals and the next experiment."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import check_given, check_out, show, write
from lerobot_pneutac.study.pair import load_pair
from lerobot_pneutac.verbs.diagnose import diagnose
from pneutac_sim.errors import InputError


@dataclass
class DiagnoseConfig:
    """Options of `pneutac diagnose`.

    Attributes:
        twin: the twin's folder; it is not changed.
        recording: a bench recording of the same finger, arm or gel.
        out: folder for `result.json` and `report.html`.
        jobs: processes; 0 for all cores.
        seed: decides which blocks of time are held out, and every bootstrap.
    """

    twin: Path | None = None
    recording: Path | None = None
    out: Path | None = None
    jobs: int = 0
    seed: int = 0

    def __post_init__(self):
        check_given(self, "twin", "recording")
        check_out(self.out)
        if self.jobs < 0:
            raise InputError(f"--jobs={self.jobs} must be 0 (all cores) or a positive number.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(DiagnoseConfig, argv), Console()
    twin, recording = load_pair(cfg.twin, cfg.recording, "diagnose")
    with progress_bar(console) as progress:
        result = diagnose(twin, recording, jobs=cfg.jobs, seed=cfg.seed, progress=progress)
    show(result, console)
    write(result, cfg.out, "diagnose", argv, console)
