"""The tasks by name: the library's own, and those that other packages bring by an entry point."""

from importlib.metadata import entry_points

from pneutac_sim.errors import InputError
from pneutac_sim.features import TASK_GROUP, task_names
from pneutac_sim.world.tasks.base import Task
from pneutac_sim.world.tasks.card import CardTask
from pneutac_sim.world.tasks.egg import EggTask
from pneutac_sim.world.tasks.switch import SwitchTask

TASKS: dict[str, type[Task]] = {"switch": SwitchTask, "egg": EggTask, "card": CardTask}


def make_task(name: str) -> Task:
    """The task called `name`.

    Raises InputError where there is none, with the names; or a package's does not load or is no task.
    """
    if name in TASKS:
        return TASKS[name]()
    found = [p for p in entry_points(group=TASK_GROUP) if p.name == name]
    if not found:
        names = [*TASKS, *(n for n in task_names() if n not in TASKS)]
        raise InputError(f"There is no task '{name}'; the tasks are {', '.join(names)}.")
    where = f"Entry point '{name}' of {TASK_GROUP} ({found[0].value})"
    if len(found) > 1:
        raise InputError(f"{where}: another package offers a task of that name too; rename one of them.")
    try:
        kind = found[0].load()
    except Exception as e:  # whatever a module of others raises
        raise InputError(f"{where} does not load: {e}.") from e
    if not (isinstance(kind, type) and issubclass(kind, Task)):
        raise InputError(f"{where} must be a class that extends pneutac_sim.world.tasks.base.Task.")
    missing = [a for a in ("name", "description", "home_m") if not hasattr(kind, a)]
    if missing or kind.name != name:
        fault = f"lacks {', '.join(missing)}" if missing else f"has the name '{kind.name}'"
        raise InputError(f"{where} {fault}; give the class name = '{name}', description and home_m.")
    return kind()
