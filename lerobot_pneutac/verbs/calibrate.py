"""`pneutac calibrate`: fits a twin to a bench recording, in place, as its next version."""

import os
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@dataclass
class CalibrateConfig:
    """Options of `pneutac calibrate`.

    Attributes:
        twin: folder of the twin; a twin of a gel is begun where there is none.
        recording: folder of the bench recording. Without it a gel is calibrated from the DIGIT photographs in
            $PNEUTAC_DATA, or from generated images where that is unset.
        out: folder for `result.json`, `report.html` and pictures.
        effects: gel only: optics effects to fit, with commas between, or `none` for the paper's linear model;
            those that the twin has, if it has been calibrated, else all that one pair of images can tell.
        by: body only: `images` (photographs with masks) or `markers` (markers and angles); by markers where
            the recording has them, else by images.
        train_kpa: body by images: pressures to fit, with commas between; all others are held out.
        evaluations: body by images: of the search.
        particles: body by images: of the body, about.
        seed: decides every random choice.
    """

    twin: Path | None = None
    recording: Path | None = None
    out: Path | None = None
    effects: str | None = None
    by: str | None = None
    train_kpa: str = "0,3,6,9,12,15"
    evaluations: int = 84
    particles: int = 4000
    seed: int = 0

    def __post_init__(self):
        if self.twin is None:
            raise InputError("Give the twin's folder with --twin=DIR.")
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError(f"--out={self.out} is a file; give a folder.")
        if self.by not in (None, "images", "markers"):
            raise InputError(f"--by={self.by} is unknown; choose images or markers.")
        if self.particles < 500 or self.evaluations < 7:
            raise InputError("--particles must be 500 or more, --evaluations 7 or more.")


def main(argv: list[str]) -> None:
    """Runs the verb with its command line options."""
    cfg = parse_options(CalibrateConfig, argv)
    with TemporaryDirectory() as tmp:
        calibrate(cfg, Path(tmp), Console())


def calibrate(cfg: CalibrateConfig, scratch: Path, console: Console) -> dict:
    """Fits the twin to the recording and writes both; returns what goes into `result.json`.

    Args:
        cfg: the options.
        scratch: a folder for generated data.
        console: where the table and remarks go.
    """
    from pneutac_datasets.recording.recording import Recording

    recording = Recording.load(cfg.recording or _default_recording(scratch, cfg.seed, console))
    for warning in recording.warnings:
        console.print(f"[yellow]note:[/] {warning}", highlight=False)
    twin = _twin(cfg.twin, recording, console)
    if recording.device == "gel":
        from lerobot_pneutac.verbs.fit_gel import calibrate_gel

        return calibrate_gel(twin, recording, cfg, console)
    from lerobot_pneutac.study.photographs import masked_cameras

    markers = [c for c in recording.observations if not c.startswith("image")]
    if cfg.by == "images" or (cfg.by is None and not markers and masked_cameras(recording)):
        from lerobot_pneutac.verbs.fit_photographs import calibrate_photographs

        return calibrate_photographs(twin, recording, cfg, console)
    from lerobot_pneutac.verbs.fit_body import calibrate_body

    return calibrate_body(twin, recording, cfg, console)


def _default_recording(scratch: Path, seed: int, console: Console) -> Path:
    real = Path(os.environ.get("PNEUTAC_DATA", "/nonexistent")) / "tactile" / "digit_nagoya"
    if real.is_dir():
        console.print(f"No --recording given: using the DIGIT photographs in {real}.", highlight=False)
        return real
    from pneutac_datasets.generate.gel import write_gel_recording

    console.print(
        "[yellow]No --recording given: using GENERATED images, not photographs.[/] "
        "Give --recording=DIR to calibrate to a real sensor."
    )
    return write_gel_recording(scratch / "generated", seed).folder


def _twin(folder: Path, recording, console: Console) -> Twin:
    """The twin to fit, which must be of the recording's device, or a finger for a gel's recording."""
    if not (folder / "twin.yaml").exists():
        if recording.device != "gel":
            raise InputError(
                f"There is no twin at '{folder}'; make one with `pneutac new --twin={folder} "
                f"--device={recording.device}`."
            )
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"'{folder}' holds no twin but something else; give an empty or new folder.")
        console.print(f"There is no twin at {folder} yet: beginning one of a gel.", highlight=False)
        return Twin(device="gel", length_mm=16.0)
    twin = Twin.load(folder)
    if twin.device != recording.device and (twin.device, recording.device) != ("finger", "gel"):
        raise InputError(
            f"{recording.folder} is a recording of a '{recording.device}' but the twin at '{folder}' is of a "
            f"'{twin.device}'; give a twin of that device."
        )
    return twin
