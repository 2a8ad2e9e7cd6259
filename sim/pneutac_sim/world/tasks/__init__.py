"""The tasks by name: the library's own, and those that other packages bring by an entry point."""

import functools
import math
import re
import traceback
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError, finite_array, load_entry_point, shown
from pneutac_sim.features import TASK_GROUP, task_names
from pneutac_sim.world.station import check_corner
from pneutac_sim.world.tasks.base import Task
from pneutac_sim.world.tasks.card import CardTask
from pneutac_sim.world.tasks.egg import EggTask
from pneutac_sim.world.tasks.switch import SwitchTask

CALLED = ("widen", "reset", "update", "success", "failure", "expert")  # of a task, while a world runs

TASKS: dict[str, type[Task]] = {"switch": SwitchTask, "egg": EggTask, "card": CardTask}


def tasks_named(instruction: str) -> list[str]:
    """Names of the tasks whose own instruction this is, else of those whose name is among its words."""
    words = re.findall(r"\w+", instruction.lower())
    own = [n for n in task_names() if _description(n) == instruction]
    return own or [n for n in task_names() if n in words]


def _description(name: str) -> str:
    """A task's instruction; none of a task that cannot be made, which is said to whoever asks for it."""
    try:
        return make_task(name).description
    except InputError:
        return ""


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
    kind = load_entry_point(found[0])
    if not (isinstance(kind, type) and issubclass(kind, Task)):
        raise InputError(f"{where} must be a class that extends pneutac_sim.world.tasks.base.Task.")
    missing = [a for a in ("name", "description", "home_m") if not hasattr(kind, a)]
    if missing or kind.name != name:
        fault = f"lacks {', '.join(missing)}" if missing else f"has the name {shown(kind.name)}"
        raise InputError(f"{where} {fault}; give the class name = '{name}', description and home_m.")
    if missing := [m for m in ("mjcf", "reset", "update", "success") if getattr(kind, m) is getattr(Task, m)]:
        raise InputError(f"{where} has no method {', '.join(missing)}; every task needs it.")
    try:
        task = _guarded(kind, where)()
        _check(task)
    except Exception as e:  # whatever a class of others raises
        why = str(e).rstrip(".") if isinstance(e, InputError) else f"fails ({type(e).__name__}: {e})"
        raise InputError(f"{where} {why}; correct its class.") from e
    return task


def _guarded(kind: type[Task], where: str) -> type[Task]:
    """The class, with methods that raise InputError, one sentence with file and line, where its own raise."""

    def guarded(name: str):
        method = getattr(kind, name)

        @functools.wraps(method)
        def call(*args, **named):
            try:
                found = method(*args, **named)
                if wanted := _wanted(name, found):
                    raise InputError(
                        f"{where}: {name} gives {shown(found)}, not {wanted}; correct its class."
                    )
                return found
            except InputError:
                raise
            except Exception as e:  # whatever a class of others raises
                frames = traceback.extract_tb(e.__traceback__)[1:]
                own = [f for f in frames if "pneutac_sim" not in Path(f.filename).parts] or frames
                line = f"{own[-1].filename}, line {own[-1].lineno}" if own else "its call"
                what = f"{where}: {name} fails in {line} ({type(e).__name__}: {e})"
                raise InputError(f"{what}; correct its class.") from e

        return call

    names = (n for n in CALLED if getattr(kind, n) is not getattr(Task, n))
    return type(kind.__name__, (kind,), {n: guarded(n) for n in names} | {"__module__": kind.__module__})


def _wanted(name: str, found: object) -> str:
    """What a method of a task must give, where it gives something else; empty where it is that."""
    if name == "success" and not isinstance(found, bool | np.bool_):
        return "True or False"
    if name == "failure" and not isinstance(found, str | None):
        return "a text or None"
    if name == "expert":
        try:
            velocity, pressure = found
            finite_array("velocity", velocity, (3,))
            finite_array("pressure", [pressure], (1,))
        except (TypeError, ValueError):  # InputError too
            return "a velocity of three finite numbers, and a finite pressure"
    return ""


def _check(task: Task) -> None:
    if not (isinstance(task.description, str) and task.description.strip()):
        raise InputError(f"has the description {shown(task.description)}, not the instruction in words")
    check_corner(task.home_m, "home_m")
    finite_array("starts_m", [*task.starts_m] or [math.nan], (-1,))
    for name in ("mjcf", "assets", "actuators"):
        if not isinstance(text := getattr(task, name)(), str):
            raise InputError(f"gives {shown(text)} from {name}(), not a text of MJCF")
