"""Fits a twin to a bench recording: markers, photographs or tactile images."""

import inspect
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np

from lerobot_pneutac.cli.options import PairOptions, keywords
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.study.pair import no_demonstrations, same_body
from lerobot_pneutac.verbs.result import Calibration, measured_range
from pneutac_datasets.demonstrations.reading import Demonstrations, is_dataset, load_demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources.plain import refuse_other_axes
from pneutac_datasets.recording.wording import an
from pneutac_sim.errors import InputError, check_choice, check_least
from pneutac_sim.executor import Progress, no_progress, one_thread
from pneutac_sim.files import check_writable
from pneutac_sim.twin import Twin, no_twin

SEARCH = "evaluations.json"  # in the folder where a search by images is stored
BEST = "best.png"  # there, the best rendering so far
METHODS = ("images", "markers")
THROUGH = ("mpm",)
SERVES = {  # an option: how a recording is fitted where the option has a use
    "by": (METHODS, "a finger or an arm"),
    **dict.fromkeys(("effects", "through", "image_size"), (("presses",), "a gel")),
    **dict.fromkeys(("train_kpa", "evaluations", "particles"), (("images",), "a fit by images")),
}


@one_thread
def calibrate(
    twin: Twin,
    recording: Recording | Demonstrations,
    *,
    by: str | None = None,
    effects: Sequence[str] | str | None = None,
    through: str | None = None,
    image_size: Sequence[int] | None = None,
    train_kpa: Sequence[float] | str = (0.0, 3.0, 6.0, 9.0, 12.0, 15.0),
    evaluations: int = 84,
    particles: int = 4000,
    seed: int = 0,
    keep: Path | None = None,
    progress: Progress = no_progress,
) -> Calibration:
    """Fits a twin to a recording; neither is changed.

    Args:
        twin: of the recording's device, or a finger for a recording of its gel.
        recording: of a finger, an arm or a gel; or demonstrations, for the gel's light at rest.
        by: of a body: `images` (photographs with masks) or `markers` (markers and angles); by markers where
            the recording has them, else by images.
        effects: of a gel: optics effects to fit, names or a text with commas between, `none` for the paper's
            linear model; if omitted, those once chosen for the twin (this way, or by `add`), else all that
            the presses identify.
        through: of a gel: `mpm` to fit its light to the surfaces that material points have under the presses,
            which takes minutes; if omitted, to those of the closed form.
        image_size: of a gel: width and height in px in which the twin has its images, such as [240,320]; if
            omitted, those of the photographs.
        train_kpa: by images: pressures to fit, with commas between; all others are held out.
        evaluations: by images: number of bodies that the search tries.
        particles: by images: number of material points of the body, about.
        seed: seed of every random choice.
        keep: by images: folder in which the search is stored so that an interrupted one continues.
        progress: called with a text, the steps done and all of them.

    Raises:
        InputError: the devices differ, or the recording does not serve.
    """
    check_choice("by", by or METHODS[0], METHODS)
    check_choice("through", through or THROUGH[0], THROUGH)
    check_least(500, particles=particles)
    check_least(7, evaluations=evaluations)
    _same_device(twin, recording, "the twin")
    from pneutac_datasets.recording.photographs import masked_cameras

    if isinstance(recording, Demonstrations):
        method = "demonstrations"
    elif recording.device == "gel":
        method = "presses"
    else:
        markers = recording.poses
        method = by or ("images" if not markers and masked_cameras(recording) else "markers")
    levels = training_levels(train_kpa)
    given = {"by": by, "effects": effects, "through": through, "image_size": image_size}
    given |= {"train_kpa": levels, "evaluations": evaluations, "particles": particles}
    for name, value in given.items():
        methods, of = SERVES[name]
        if method not in methods and value != inspect.signature(calibrate).parameters[name].default:
            more = ", and switch an effect on with `pneutac add --effect=NAME`" * (name == "effects")
            why = f"{name} is for {of}, but {recording.folder} is fitted by its {method}"
            raise InputError(f"{why}; omit it{more}.")
    if isinstance(recording, Demonstrations):
        from lerobot_pneutac.verbs.compare_demonstrations import calibrate_demonstrations

        return calibrate_demonstrations(twin, recording, seed)
    if recording.device == "gel":
        from lerobot_pneutac.verbs.fit_gel import calibrate_gel

        if isinstance(effects, str):
            effects = [e.strip() for e in effects.split(",") if e != "none"]
        return calibrate_gel(twin, recording, effects, image_size, through == "mpm", progress)
    recording = same_body(twin, recording, "calibrate")
    if method == "images":
        from lerobot_pneutac.verbs.fit_photographs import calibrate_photographs

        how = {"evaluations": evaluations, "particles": particles, "seed": seed, "progress": progress}
        how |= {} if keep is None else {"file": keep / SEARCH, "best": keep / BEST}
        result = calibrate_photographs(twin, recording, levels, **how)
    else:
        from lerobot_pneutac.verbs.fit_body import calibrate_body

        refuse_other_axes(recording)
        result = calibrate_body(twin, recording, seed, progress)
    fitted = result.twin.copy()  # which knows over which pressures it was fitted
    fitted.pressure_range_kpa = measured_range(recording) or fitted.pressure_range_kpa
    return replace(result, twin=fitted)


def _same_device(twin: Twin, recording: Recording | Demonstrations, name: str) -> None:
    """Raises InputError where the devices differ; a finger takes the recording of its gel."""
    if twin.device != recording.device and (twin.device, recording.device) != ("finger", "gel"):
        both = f"a recording of {an(recording.device)}, but {name} is of {an(twin.device)}"
        raise InputError(f"{recording.folder} is {both}; give a twin of that device.")


def training_levels(levels: Sequence[float] | str) -> tuple[float, ...]:
    """Pressures in kPa, or a text with commas between; raises InputError where they are not two numbers."""
    shown = levels if isinstance(levels, str) else ",".join(f"{v:g}" for v in levels)
    try:
        out = tuple(float(v) for v in (levels.split(",") if isinstance(levels, str) else levels))
    except ValueError:
        out = ()
    if len(out) < 2 or not np.isfinite(out).all():
        raise InputError(f"train_kpa={shown} must be at least two pressures in kPa, such as 0,3,6,9,12,15.")
    return out


@dataclass
class CalibrateConfig(PairOptions):
    """Options of `pneutac calibrate`.

    Attributes:
        twin: folder of the twin; a twin of a gel is begun where there is none.
        out: folder for `result.json`, `report.html` and pictures.
    """

    described_by: ClassVar = calibrate

    # folder of the bench recording, or tables as `pneutac convert` reads them; without it a twin of a gel is
    # begun, from the DIGIT photographs in $PNEUTAC_DATA or generated images. Of a LeRobotDataset of
    # demonstrations, or its name on the Hub, the gel's light at rest is taken
    recording: Path | None = None  # pyright: ignore[reportIncompatibleVariableOverride]
    effects: str | None = None
    through: str | None = None
    image_size: tuple[int, int] | None = None
    save_prior: str | None = None  # name under which a gel's light is stored for other sensors of its model
    by: str | None = None
    train_kpa: str = "0,3,6,9,12,15"
    evaluations: int = 84
    particles: int = 4000
    seed: int = 0


def command(cfg: CalibrateConfig, terminal: Terminal) -> None:
    with TemporaryDirectory() as scratch:
        result = run(cfg, Path(scratch), terminal)
        result = terminal.finish(result, cfg.out, store=None if result.worse else cfg.twin)
    for name in (SEARCH, BEST) if cfg.out is None and not result.worse else ():
        (cfg.twin / name).unlink(missing_ok=True)
    if result.worse:
        raise InputError(result.worse)


def run(cfg: CalibrateConfig, scratch: Path, terminal: Terminal) -> Calibration:
    """Fits; `scratch` is for generated data."""
    recording, note = recording_for(cfg, scratch)
    terminal.console.print(note, end="\n" if note else "", highlight=False)
    check_writable(cfg.twin, f"--twin={cfg.twin}")
    if cfg.save_prior is not None:
        from pneutac_sim.gel.identifiability import check_name

        if recording.device != "gel":
            raise InputError(f"save_prior stores a gel's light, which {recording.folder} is not of; omit it.")
        check_name(cfg.save_prior)
    twin, keep = twin_for(cfg.twin, recording), cfg.out or cfg.twin
    if not (cfg.twin / "twin.yaml").exists():
        terminal.say(f"There is no twin at {cfg.twin} yet: beginning one of a gel.")
    if twin.missing:
        terminal.note(f"{cfg.twin}/twin.yaml has no {', '.join(twin.missing)}; the fit begins at defaults.")
    try:
        result = terminal.run(calibrate, twin, recording, **keywords(cfg, calibrate) | {"keep": keep})
    except KeyboardInterrupt:
        file, stopped = keep / SEARCH, "Stopped before the first candidates were evaluated"
        if file.is_file() and (count := len(json.loads(file.read_text())["evaluations"])):
            goes_on = "the same command continues from here"
            stopped = f"Stopped after {count} evaluations, stored in {file}; {goes_on}"
        terminal.say(f"{stopped}; the twin is unchanged.")
        raise
    if note and isinstance(recording, Recording) and recording.meta.get("generated"):
        result = replace(result, recording=f"generated images (seed {cfg.seed})")  # their folder goes
    if cfg.save_prior is not None and not result.worse:
        from lerobot_pneutac.verbs.fit_gel import GelCalibration

        assert isinstance(result, GelCalibration)
        terminal.say(f"Stored the sensor's illumination as {result.save_prior(cfg.save_prior)}.")
    return result


def recording_for(cfg: CalibrateConfig, scratch: Path) -> tuple[Recording | Demonstrations, str]:
    """The recording, and a sentence where none was given.

    Without one the DIGIT photographs in $PNEUTAC_DATA, or images generated in folder `scratch` where that is
    unset; raises InputError where the twin exists already, which those do not measure.
    """
    folder, exists = cfg.recording, (cfg.twin / "twin.yaml").exists()
    if folder is not None and is_dataset(folder):
        known = Twin.load(cfg.twin) if exists else None
        return load_demonstrations(folder, cfg.task, known, station=cfg.station), ""
    no_demonstrations(folder or "what is taken without --recording", cfg.task, cfg.station)
    if folder is not None:
        return Recording.load(folder), ""
    if exists:
        raise InputError(f"Give --recording=DIR, what the twin at '{cfg.twin}' is to be fitted to.")
    real = Path(os.environ.get("PNEUTAC_DATA", "/nonexistent")) / "tactile" / "digit_nagoya"
    if real.is_dir():
        return Recording.load(real), f"No --recording given: using the DIGIT photographs in {real}."
    from pneutac_datasets.generate.gel import write_gel_recording

    note = "[yellow]No --recording given: using GENERATED images, not photographs.[/]"
    remedy = "Give --recording=DIR to calibrate to a real sensor."
    return write_gel_recording(scratch / "generated", cfg.seed), f"{note} {remedy}"


def twin_for(folder: Path, recording: Recording | Demonstrations) -> Twin:
    """The twin in a folder; a twin of a gel is begun where there is none yet, any other is refused."""
    if (folder / "twin.yaml").exists():
        finds = isinstance(recording, Recording) and recording.device != "gel"
        twin = Twin.load(folder, calibrated=not finds)
        _same_device(twin, recording, f"the twin at '{folder}'")
        return twin
    if recording.device != "gel":
        bench = isinstance(recording, Recording)  # `new` takes the device and its geometry from it
        of = {"recording": recording.folder} if bench else {"device": recording.device}
        raise InputError(no_twin(folder, **of))
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"'{folder}' holds no twin but something else; give an empty or new folder.")
    return Twin(device="gel", length_mm=16.0)
