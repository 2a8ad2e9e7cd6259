"""`pneutac compare`: compares a twin with a recording, and shows where it fails."""

from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import TableOptions, parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.study.pair import load_bench_pair, load_pair
from lerobot_pneutac.verbs.ageing import ageing
from lerobot_pneutac.verbs.compare import check_fidelity, compare
from pneutac_sim.errors import InputError


@dataclass
class CompareConfig(TableOptions):
    """Options of `pneutac compare`.

    Attributes:
        twin: folder of the twin.
        recording: folder of a bench recording, or tables as `pneutac convert` reads them of the same device;
            or of a LeRobotDataset of demonstrations, or its name on the Hub, which are replayed in the twin's
            world.
        task: of demonstrations: what stood in front of the robot, where their instruction does not tell.
        station: of demonstrations: `station.yaml` of the arm and its place; left out, the one that their
            robot left in them, or the paper's.
        out: folder for `result.json` and `report.html`; nothing is written without it.
        fidelity: `pipeline` (the twin's kinematics, every sample) or `mpm` (of a finger or an arm: the full
            body of material points, at samples spread over the recording).
        samples: largest number of samples by mpm; where left out, 200.
        later: recordings of the same finger or arm on other dates: how it ages, when to calibrate it again.
        seed: seed of the choice of the samples by mpm, and of the demonstrations that are held out.
    """

    twin: Path
    recording: Path
    task: str = ""
    station: Path | None = None
    out: Path | None = None
    fidelity: str = "pipeline"
    samples: int | None = None
    later: list[Path] = field(default_factory=list)
    seed: int = 0

    def __post_init__(self):
        check_fidelity(self.fidelity, self.samples)
        if self.later and self.fidelity != "pipeline":
            raise InputError(f"later is compared by the pipeline, not by fidelity={self.fidelity}; omit it.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(CompareConfig, argv), Console()
    if cfg.later:
        pairs = [load_bench_pair(cfg.twin, p, "tell ageing by") for p in (cfg.recording, *cfg.later)]
        result = ageing(pairs[0][0], [recording for _, recording in pairs], cfg.seed)
        finish(result, console, cfg.out, "compare", argv)
        return
    twin, recording = load_pair(cfg.twin, cfg.recording, "compare", cfg.task, cfg.station)
    with progress_bar(Console(stderr=True)) as progress:
        result = compare(
            twin, recording, fidelity=cfg.fidelity, samples=cfg.samples, seed=cfg.seed, progress=progress
        )
    finish(result, console, cfg.out, "compare", argv)
