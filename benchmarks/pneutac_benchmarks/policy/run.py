"""Carries out the units of the policy benchmark, and keeps what is finished."""

import json
import math
import os
import time
import traceback
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import torch

from pneutac_benchmarks.policy.plan import RESULT, Unit, as_dict
from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions, Progress, no_progress, run_pieces
from pneutac_sim.files import write_json

LOG = "log.txt"
GPU_TRAININGS = 6  # side by side on each GPU of this machine


def finished(out: Path, unit: Unit) -> dict | None:
    """What an earlier run found; None where the unit is not finished.

    Raises:
        InputError: it was finished with other options, or its file is damaged.
    """
    path = out / unit.name / RESULT
    if not path.exists():
        return None
    try:
        found = json.loads(path.read_text())
        made = found["unit"]
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"'{path}' is damaged; delete '{path.parent}'.") from e
    if "result" not in found:  # it failed, or was not begun
        return None
    if made != json.loads(json.dumps(as_dict(unit))):
        raise InputError(f"'{path.parent}' was made with other options; give another folder, or delete it.")
    return found


def run_units(
    out: Path,
    units: list[Unit],
    options: ExecutorOptions,
    progress: Progress = no_progress,
    until: float = math.inf,
) -> tuple[dict[str, dict], dict[str, str], list[str]]:
    """Carries out what is not finished, in stages: units whose needs are there, then those that need them.

    Args:
        out: the benchmark's folder.
        units: those that others need first, and those that count most.
        options: where the units are carried out.
        progress: is called with the kinds of a stage, and how many of its units are done.
        until: `time.time()` after which no unit is begun; the units that were not are in neither result.

    Returns:
        unit name to what is in its `unit.json`; unit name to a sentence for those that could not be done; and
        the names of those among them that ended in a fault, not in an InputError.

    Raises:
        InputError: a process ended, or the cluster refuses the work; the same command goes on.
    """
    done = {u.name: found for u in units if (found := finished(out, u)) is not None}
    failed: dict[str, str] = {}
    faults: list[str] = []
    for wanted in _rounds(units, until):
        waiting = [u for u in wanted if u.name not in done and u.name not in failed]
        for unit in waiting:
            (out / unit.name / RESULT).unlink(missing_ok=True)  # of a run in which it failed
        while stage := _ready(waiting, done):
            files = [out / u.name / RESULT for u in stage]
            kinds = ", ".join(sorted({u.kind for u in stage}))
            run_pieces(
                partial(run_unit, out, stage, until),
                files,
                out / "logs",
                _on(options, stage),
                progress,
                kinds,
            )
            for unit, file in zip(stage, files, strict=True):
                found = json.loads(file.read_text())
                if "result" in found:
                    done[unit.name] = found
                elif "failed" in found:
                    failed[unit.name] = found["failed"]
                    faults += [unit.name] * found["fault"]
            waiting = [u for u in waiting if u not in stage]
            for unit in waiting:
                if missing := next((n for n in unit.needs if n in failed), None):
                    failed[unit.name] = f"needs {missing}"
    return done, failed, faults


def _rounds(units: list[Unit], until: float) -> Iterator[list[Unit]]:
    """All at once, or seed by seed where the time may end before all are done."""
    if until == math.inf:
        yield units
        return
    named = {u.name: u for u in units}
    for seed in dict.fromkeys(u.name.split("/")[1] for u in units):
        names = [u.name for u in units if u.name.split("/")[1] == seed]
        for name in names:
            names += [n for n in named[name].needs if n not in names]
        yield [u for u in units if u.name in names]


def _ready(waiting: list[Unit], done: dict[str, dict]) -> list[Unit]:
    """Units whose needs are there; those of a GPU alone."""
    ready = [u for u in waiting if set(u.needs) <= done.keys()]
    return [u for u in ready if not _on_gpu(u)] or ready


def _on(options: ExecutorOptions, stage: list[Unit]) -> ExecutorOptions:
    """Where a stage is carried out: few at a time where they share this machine's GPUs."""
    given = {name: getattr(options, name) for name in ExecutorOptions.__dataclass_fields__}
    if options.executor == "local" and _on_gpu(stage[0]):
        most = GPU_TRAININGS * torch.cuda.device_count()
        given["workers"] = min(options.workers or len(os.sched_getaffinity(0)), most)
    return ExecutorOptions(**given)


def _on_gpu(unit: Unit) -> bool:
    return unit.options.get("device") == "cuda"


def run_unit(out: Path, units: list[Unit], until: float, number: int) -> None:
    """Carries out a unit and writes its `unit.json`; all that this process prints goes to the unit's log."""
    unit = units[number]
    folder, found = out / unit.name, {"unit": as_dict(unit)}
    folder.mkdir(parents=True, exist_ok=True)
    if time.time() > until:
        write_json(folder / RESULT, found)
        return
    with (folder / LOG).open("a") as log:
        for stream in (1, 2):  # also what libraries in C print
            os.dup2(log.fileno(), stream)
    os.environ["HF_HUB_OFFLINE"] = "1"  # what lies here is not looked for on the Hub
    from pneutac_benchmarks.policy.units import KINDS

    start = time.monotonic()
    try:
        found["result"] = KINDS[unit.kind](folder, unit.options, [out / need for need in unit.needs])
        found["seconds"] = time.monotonic() - start
    except InputError as e:
        found |= {"failed": str(e), "fault": False}
    except Exception as e:  # the other units go on; the command ends with an error
        with (folder / LOG).open("a") as log:
            log.writelines(traceback.format_exception(e))
        found |= {"failed": f"{type(e).__name__}: {e} (see '{folder / LOG}')", "fault": True}
    write_json(folder / RESULT, found)
