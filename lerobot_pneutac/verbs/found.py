"""What a diagnosis wrote to a folder, as `add` takes it up again."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_pneutac.diagnosis.result import Candidate
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, option
from pneutac_sim.files import write_json
from pneutac_sim.twin import Twin

FILE = "contenders.json"  # the models between which a diagnosis could not yet choose
BEFORE, BASELINE, FOUND = "before", "baseline", "found"  # folders of twins in that of the report


@dataclass(frozen=True)
class WrittenDiagnosis:
    """A diagnosis in a folder.

    Attributes:
        result: its `result.json`.
        before: the twin as it was, re-fitted.
        baseline: with the known causes that the recording shows; None where there are none.
        found: the twin with all that was found.
    """

    result: Mapping
    before: Twin
    baseline: Twin | None
    found: Twin


def read_found(folder: str | Path, recording: Recording | Demonstrations) -> WrittenDiagnosis:
    """Reads what `pneutac diagnose --out=FOLDER` wrote.

    Args:
        folder: of the diagnosis.
        recording: that was diagnosed.

    Raises:
        InputError: the folder holds no diagnosis, or one of another recording.
    """
    file = Path(folder) / "result.json"
    if not file.is_file():
        raise InputError(
            f"There is no diagnosis at '{folder}'; make one with `pneutac diagnose {option('out', folder)}`."
        )
    result = json.loads(file.read_text())
    if "verdict" not in result or not (Path(folder) / FOUND).is_dir():
        raise InputError(f"{file} is not the result of a body's diagnosis; give the folder that it wrote.")
    if result["rows"] != len(recording):
        raise InputError(
            f"{file} is of a recording of {result['rows']} rows and {recording.folder} has {len(recording)}; "
            "give the recording that was diagnosed."
        )
    twins = [Path(folder) / name for name in (BEFORE, BASELINE, FOUND)]
    return WrittenDiagnosis(result, *(Twin.load(f) if f.is_dir() else None for f in twins))


def described(contenders: Sequence[Candidate]) -> list[dict]:
    """Terms and probability of each."""
    return [{"terms": list(c.terms), "probability": c.probability} for c in contenders]


def save_contenders(folder: str | Path, contenders: Sequence[Candidate]) -> None:
    """Writes their twins, and last what they are."""
    for i, c in enumerate(contenders):
        c.twin.save(Path(folder) / "contenders" / str(i))
    write_json(Path(folder) / FILE, described(contenders))


def load_contenders(folder: str | Path) -> list[Candidate]:
    """What `save_contenders` wrote; raises InputError where there is nothing."""
    file = Path(folder) / FILE
    if not file.is_file():
        raise InputError(f"There is no {file}; give the folder that `pneutac diagnose --out=` wrote.")
    stored = json.loads(file.read_text())
    return [
        Candidate(Twin.load(Path(folder) / "contenders" / str(i)), tuple(c["terms"]), c["probability"])
        for i, c in enumerate(stored)
    ]
