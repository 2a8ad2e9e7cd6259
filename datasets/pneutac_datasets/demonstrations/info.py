"""What a LeRobotDataset tells of itself, read without LeRobot."""

import json
import re
from pathlib import Path

from pneutac_sim.errors import InputError, shown

VERSION = 3  # of LeRobot's datasets
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


def refuse_version(file: Path, info: dict) -> None:
    """Raises InputError where an `info.json` is of another version of LeRobot's datasets than 3."""
    version = info.get("codebase_version")
    found = re.fullmatch(r"v?(\d+)\.\d+(\.\d+)?", str(version))
    if found and int(found[1]) == VERSION:
        return
    root = file.parent.parent
    if str(version) == "v2.1":
        remedy = (
            "convert it with `python -m lerobot.scripts.convert_dataset_v21_to_v30"
            f" --repo-id=local/{root.name} --root={root} --push-to-hub=false`"
        )
    elif found and int(found[1]) < VERSION:
        remedy = "convert it with the LeRobot that recorded it, first to v2.1 and then to v3.0"
    elif found:
        remedy = "it was recorded with a newer LeRobot; install that one, or record anew"
    else:
        remedy = "restore the file"
    raise InputError(f"{file}: codebase_version is {shown(version)}, and v3.0 is read here; {remedy}.")
