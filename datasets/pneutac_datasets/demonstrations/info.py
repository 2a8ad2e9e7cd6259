"""What a LeRobotDataset tells of itself, read without LeRobot."""

import json
from pathlib import Path

from pneutac_sim.errors import InputError

STATE, ACTION = "observation.state", "action"


def is_demonstrations(folder: str | Path) -> bool:
    """Whether a folder is a LeRobotDataset of a robot rather than a bench recording."""
    file = Path(folder) / "meta" / "info.json"
    return file.is_file() and {STATE, ACTION} & set(read_info(file).get("features", {})) != set()


def read_info(file: Path) -> dict:
    """The content of its `meta/info.json`; raises InputError where that is damaged."""
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as e:
        raise InputError(f"{file} is not valid JSON ({e}); the dataset is damaged.") from e
    if not isinstance(info, dict):
        raise InputError(f"{file} must hold a JSON object; the dataset is damaged.")
    return info
