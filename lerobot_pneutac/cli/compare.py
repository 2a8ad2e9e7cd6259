"""`pneutac compare`: how far a twin is from a recording, and where it fails."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import check_given, check_out, show, write
from lerobot_pneutac.study.pair import load_pair
from lerobot_pneutac.verbs.compare import check_fidelity, compare


@dataclass
class CompareConfig:
    """Options of `pneutac compare`.

    Attributes:
        twin: the twin's folder.
        recording: a bench recording of the same device.
        out: folder for `result.json` and `report.html`; nothing is written without it.
        fidelity: `pipeline` (the twin's kinematics, every sample) or `mpm` (of a finger or an arm: the full
            body of material points, at samples spread over the recording).
        samples: by mpm: at most so many, 200 where left out.
        seed: decides which blocks of time are held out, where the twin was not fitted on this recording, and
            which samples are simulated by mpm.
    """

    twin: Path | None = None
    recording: Path | None = None
    out: Path | None = None
    fidelity: str = "pipeline"
    samples: int | None = None
    seed: int = 0

    def __post_init__(self):
        check_given(self, "twin", "recording")
        check_fidelity(self.fidelity, self.samples)
        check_out(self.out)


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(CompareConfig, argv), Console()
    twin, recording = load_pair(cfg.twin, cfg.recording, "compare")
    with progress_bar(console) as progress:
        result = compare(
            twin, recording, fidelity=cfg.fidelity, samples=cfg.samples, seed=cfg.seed, progress=progress
        )
    show(result, console)
    write(result, cfg.out, "compare", argv, console)
