"""What demonstrations are of: whether a folder holds some, their task, and folders of new ones."""

import re
from pathlib import Path

from pneutac_sim.dataset_files import ACTION, ROBOT, STATE
from pneutac_sim.errors import InputError
from pneutac_sim.features import library_tasks, task_names
from pneutac_sim.pace import read_info


def is_demonstrations(folder: str | Path) -> bool:
    """Whether a folder is a LeRobotDataset of a robot rather than a bench recording.

    One of another robot than this one that names a commanded pressure in kPa was measured on a bench.
    """
    file = Path(folder) / "meta" / "info.json"
    if not file.is_file():
        return False
    info = read_info(file)
    features = info["features"]
    if not {STATE, ACTION} & set(features):
        return False
    entries = {str(n) for f in features.values() for n in _names(f)} | set(features)
    measured = any(re.fullmatch(r"pressure_cmd_(\d+_)?kpa", n) for n in entries)
    return not (measured and info.get("robot_type") != ROBOT)


def _names(feature: dict) -> list:
    names = feature.get("names") or []
    names = next(iter(names.values()), []) if isinstance(names, dict) else names
    return names if isinstance(names, list) else []


def work_folder(out_root: Path) -> Path:
    """Where pieces of a new dataset lie until it is whole."""
    return out_root.with_name(out_root.name + ".work")


def check_new(out_root: Path, repo_id: str) -> None:
    """Raises InputError where a new dataset's folder exists, and no run is left to be tidied up there."""
    if out_root.exists() and not work_folder(out_root).exists():
        raise InputError(f"'{out_root}' exists; give a new folder for dataset '{repo_id}'.")


def task_to_do(given: str, instructions: list[str], folder: Path) -> str:
    """The task that demonstrations are of: the given one, or the one that their instructions name.

    Raises InputError: the instructions name none, several, or another one of the library's than was given.
    """
    from pneutac_sim.world.tasks import tasks_named

    if not given:
        tasks = {text: task_of(text, folder) for text in instructions}
        if len(set(tasks.values())) > 1:
            several = " and ".join(f"'{task}' ('{text}')" for text, task in tasks.items())
            raise InputError(f"{folder} holds demonstrations of {several}; give a dataset of one task.")
        return next(iter(tasks.values()))
    for text, named in ((text, tasks_named(text)) for text in instructions):
        if len(named) == 1 and named[0] != given and {given, *named} <= library_tasks():
            raise InputError(
                f"{folder}: the instruction '{text}' names the task '{named[0]}', not --task={given};"
                f" give demonstrations of '{given}', or --task={named[0]}."
            )
    return given


def task_of(instruction: str, folder: Path) -> str:
    """The task whose own instruction this is, or the only one that it names.

    Raises InputError: it is none's.
    """
    from pneutac_sim.world.tasks import tasks_named

    if len(named := tasks_named(instruction)) == 1:
        return named[0]
    raise InputError(
        f"{folder}: the instruction '{instruction}' names no task; say with task= which of "
        f"{', '.join(task_names())} stood in front of the robot."
    )
