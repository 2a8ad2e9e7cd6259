"""What a diagnosis wrote to a folder, as `add` takes it up again."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

BEFORE, FOUND = "before", "found"  # folders of twins, beside the report


@dataclass(frozen=True)
class WrittenDiagnosis:
    """A diagnosis in a folder.

    Attributes:
        told: its `result.json`.
        before: the twin as it was, re-fitted.
        found: the twin with all that was found.
    """

    told: Mapping
    before: Twin
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
            f"There is no diagnosis at '{folder}'; make one with `pneutac diagnose --out={folder}`."
        )
    told = json.loads(file.read_text())
    if "verdict" not in told or not (Path(folder) / FOUND).is_dir():
        raise InputError(f"{file} is not the result of a body's diagnosis; give the folder that it wrote.")
    if told["rows"] != len(recording):
        raise InputError(
            f"{file} is of a recording of {told['rows']} rows and {recording.folder} has {len(recording)}; "
            "give the recording that was diagnosed."
        )
    return WrittenDiagnosis(told, Twin.load(Path(folder) / BEFORE), Twin.load(Path(folder) / FOUND))
