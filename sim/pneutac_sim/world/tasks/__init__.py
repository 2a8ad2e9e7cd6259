"""The tasks by name."""

from pneutac_sim.errors import InputError
from pneutac_sim.world.tasks.base import Task
from pneutac_sim.world.tasks.card import CardTask
from pneutac_sim.world.tasks.egg import EggTask
from pneutac_sim.world.tasks.switch import SwitchTask

TASKS: dict[str, type[Task]] = {"switch": SwitchTask, "egg": EggTask, "card": CardTask}


def make_task(name: str) -> Task:
    """The task called `name`; raises InputError listing the names."""
    if name not in TASKS:
        raise InputError(f"There is no task '{name}'; the tasks are {', '.join(TASKS)}.")
    return TASKS[name]()
