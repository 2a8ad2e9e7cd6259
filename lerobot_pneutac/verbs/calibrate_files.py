"""What `pneutac calibrate` finds and leaves in folders: recording, twin, an interrupted search."""

import json
import os
from pathlib import Path

from lerobot_pneutac.verbs.calibration import Calibration
from pneutac_datasets.demonstrations.replay.reading import Demonstrations, is_dataset, load_demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, option
from pneutac_sim.twin import Twin

SEARCH = "evaluations.json"  # in the folder where a search by images is kept
BEST = "best.png"  # there, the best rendering so far


def recording_for(
    folder: Path | None,
    scratch: Path,
    seed: int,
    task: str = "",
    twin: Path | None = None,
    station: Path | None = None,
) -> tuple[Recording | Demonstrations, str]:
    """The recording, and a sentence where none was given.

    Without one the DIGIT photographs in $PNEUTAC_DATA, or images generated in folder `scratch` where that is
    unset.

    Raises:
        InputError: none was given for a twin that exists, which those do not measure; or as the readers.
    """
    if folder is not None and is_dataset(folder):
        known = Twin.load(twin) if twin and (twin / "twin.yaml").exists() else None
        return load_demonstrations(folder, task, known, station=station), ""
    if folder is not None:
        return Recording.load(folder), ""
    if twin and (twin / "twin.yaml").exists():
        raise InputError(f"Give --recording=DIR: which measurement is the twin at '{twin}' to be fitted to?")
    real = Path(os.environ.get("PNEUTAC_DATA", "/nonexistent")) / "tactile" / "digit_nagoya"
    if real.is_dir():
        return Recording.load(real), f"No --recording given: using the DIGIT photographs in {real}."
    from pneutac_datasets.generate.gel import write_gel_recording

    return Recording.load(write_gel_recording(scratch / "generated", seed).folder), (
        "[yellow]No --recording given: using GENERATED images, not photographs.[/] "
        "Give --recording=DIR to calibrate to a real sensor."
    )


def twin_for(folder: Path, recording: Recording | Demonstrations) -> Twin:
    """The twin in a folder; a twin of a gel is begun where there is none yet.

    Raises:
        InputError: there is none and the recording is of a body, the folder holds something else, or the
            devices differ.
    """
    if (folder / "twin.yaml").exists():
        twin = Twin.load(folder)
        if twin.device != recording.device and (twin.device, recording.device) != ("finger", "gel"):
            raise InputError(
                f"{recording.folder} is a recording of a '{recording.device}' but the twin at '{folder}' is "
                f"of a '{twin.device}'; give a twin of that device."
            )
        return twin
    if recording.device != "gel":
        raise InputError(
            f"There is no twin at '{folder}'; make one with `pneutac new {option('twin', folder)} "
            f"--device={recording.device}`."
        )
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"'{folder}' holds no twin but something else; give an empty or new folder.")
    return Twin(device="gel", length_mm=16.0)


def check_prior(name: str | None, recording: Recording | Demonstrations) -> None:
    """Raises InputError, before any work, where a prior cannot be kept under this name."""
    if name is None:
        return
    if recording.device != "gel":
        raise InputError(
            f"save_prior keeps a gel's lights, but {recording.folder} is of a '{recording.device}'; omit it."
        )
    from pneutac_sim.gel.makes import check_name

    check_name(name)


def keep_prior(result: Calibration, name: str | None) -> str:
    """Keeps a gel's lights under this name; returns a line that tells where, empty where there is no name."""
    if name is None:
        return ""
    from lerobot_pneutac.verbs.fit_gel import GelCalibration

    assert isinstance(result, GelCalibration)
    return f"Kept the sensor's lights as {result.save_prior(name)}.\n"


def stopped(keep: Path) -> str:
    """What to say where a calibration was interrupted."""
    search = keep / SEARCH
    count = len(json.loads(search.read_text())["evaluations"]) if search.is_file() else 0
    if not count:
        return "Stopped before the first candidates were evaluated; the twin is as it was."
    return (
        f"Stopped after {count} evaluations, kept in {search}; the twin is as it was, and the same command "
        "goes on from here."
    )


def forget_search(keep: Path) -> None:
    """Deletes the search that was kept."""
    for name in (SEARCH, BEST):
        (keep / name).unlink(missing_ok=True)
