"""Where the answer to a generated recording is: next to its folder, never in it."""

import json
from pathlib import Path


def truth_file(recording: str | Path) -> Path:
    """`truth/NAME.json` next to the folder `NAME` of a recording."""
    recording = Path(recording)
    return recording.parent / "truth" / f"{recording.name}.json"


def write_truth(recording: str | Path, truth: dict) -> None:
    """Writes the hidden truth of a recording."""
    file = truth_file(recording)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(truth, indent=1) + "\n")
