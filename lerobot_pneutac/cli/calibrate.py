"""`pneutac calibrate`: fits a twin to a bench recording, in place, as its next version."""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from lerobot_pneutac.cli.options import TableOptions, parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.verbs import calibrate_files as files
from lerobot_pneutac.verbs.calibrate import calibrate
from lerobot_pneutac.verbs.calibration import Calibration
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.files import check_writable


@dataclass
class CalibrateConfig(TableOptions):
    """Options of `pneutac calibrate`.

    Attributes:
        twin: folder of the twin; a twin of a gel is begun where there is none.
        recording: folder of the bench recording, or tables as `pneutac convert` reads them; without it a twin
            of a gel is begun, from the DIGIT photographs in $PNEUTAC_DATA or generated images. Of a
            LeRobotDataset of demonstrations, or its name on the Hub, the gel's light at rest is taken.
        task: of demonstrations: what stood in front of the robot, where their instruction does not tell.
        station: of demonstrations: `station.yaml` of the arm and its place; left out, the one that their
            robot left in them, or the paper's.
        out: folder for `result.json`, `report.html` and pictures.
        effects: optics effects of a gel to fit, with commas between, or `none` for the paper's linear model;
            where left out, those once chosen for the twin, else all that the presses can tell.
        through: `mpm` to fit a gel's light to the surfaces that material points have under the presses, which
            takes minutes; where left out, to those of the closed form.
        image_size: width and height in px in which the twin has a gel's images, such as [240,320]; where left
            out, those of the photographs.
        save_prior: name under which a gel's lights are kept for other sensors of its make.
        by: what a finger or an arm is fitted to: `images` (photographs with masks) or `markers` (markers and
            angles); where left out, markers if the recording has them, else images.
        train_kpa: pressures to fit by images, with commas between; all others are held out.
        evaluations: bodies that the search by images tries.
        particles: number of material points of a body by images, about.
        seed: seed of every random choice.
    """

    twin: Path
    recording: Path | None = None
    task: str = ""
    station: Path | None = None
    out: Path | None = None
    effects: str | None = None
    through: str | None = None
    image_size: tuple[int, int] | None = None
    save_prior: str | None = None
    by: str | None = None
    train_kpa: str = "0,3,6,9,12,15"
    evaluations: int = 84
    particles: int = 4000
    seed: int = 0


def main(argv: list[str]) -> None:
    """Runs the verb with its command line options."""
    cfg, console = parse_options(CalibrateConfig, argv), Console()
    with TemporaryDirectory() as scratch:
        result = run(cfg, Path(scratch), console)
    finish(result, console, cfg.out, "calibrate", argv)
    if result.worse:
        raise InputError(result.worse)


def run(cfg: CalibrateConfig, scratch: Path, console: Console) -> Calibration:
    """Fits and, unless it is worse, saves the twin's next version; `scratch` is for generated data."""
    recording, note = files.recording_for(cfg.recording, scratch, cfg.seed, cfg.task, cfg.twin, cfg.station)
    console.print(note, end="\n" if note else "", highlight=False)
    check_writable(cfg.twin, f"--twin={cfg.twin}")
    files.check_prior(cfg.save_prior, recording)
    twin, keep = files.twin_for(cfg.twin, recording), cfg.out or cfg.twin
    if not (cfg.twin / "twin.yaml").exists():
        console.print(f"There is no twin at {cfg.twin} yet: beginning one of a gel.", highlight=False)
    try:
        with progress_bar(Console(stderr=True)) as progress:
            result = calibrate(
                twin, recording, by=cfg.by, effects=cfg.effects, through=cfg.through,
                image_size=cfg.image_size, train_kpa=cfg.train_kpa, seed=cfg.seed,
                evaluations=cfg.evaluations, particles=cfg.particles, keep=keep, progress=progress,
            )  # fmt: skip
    except KeyboardInterrupt:
        console.print(files.stopped(keep), highlight=False, soft_wrap=True)
        raise
    if result.worse:
        return result
    if cfg.out is None:
        files.forget_search(keep)
    if (
        note and isinstance(recording, Recording) and recording.meta.get("generated")
    ):  # their folder is gone after this run
        result = replace(result, recording=f"generated images (seed {cfg.seed})")
    console.print(files.keep_prior(result, cfg.save_prior), end="", highlight=False)
    return result.save(cfg.twin)
