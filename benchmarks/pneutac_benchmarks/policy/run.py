"""Carries out the units of the policy benchmark in processes, and keeps what is finished."""

import contextlib
import json
import math
import multiprocessing
import os
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import torch

from pneutac_benchmarks.policy.plan import RESULT, Unit, as_dict
from pneutac_sim.errors import InputError
from pneutac_sim.executor import process_pool
from pneutac_sim.files import write_json

LOG = "log.txt"
GPU_TRAININGS = 6  # side by side on each
# Each process computes on one thread, and none asks the Hub for datasets that lie here.
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}


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
    if made != json.loads(json.dumps(as_dict(unit))):
        raise InputError(f"'{path.parent}' was made with other options; give another folder, or delete it.")
    return found


def run_units(
    out: Path,
    units: list[Unit],
    jobs: int,
    progress: Callable[[float, str], None],
    until: float = math.inf,
) -> tuple[dict[str, dict], dict[str, str], list[str]]:
    """Carries out what is not finished, in the order of what needs what.

    Args:
        out: the benchmark's folder.
        units: those that others need first, and those that count most.
        jobs: processes.
        progress: is told the share that is done and a few words.
        until: `time.monotonic()` after which no unit is begun; the units that were not are in neither result.

    Returns:
        unit name to what is in its `unit.json`; unit name to a sentence for those that could not be done; and
        the names of those among them that ended in a fault, not in an InputError.
    """
    done = {u.name: found for u in units if (found := finished(out, u)) is not None}
    failed: dict[str, str] = {}
    faults: list[str] = []
    waiting = {u.name: u for u in units if u.name not in done}
    gpus = torch.cuda.device_count()
    running: dict[Future, Unit] = {}
    total = sum(u.core_s for u in units)

    def show(words: str) -> None:
        over = sum(u.core_s for u in units if u.name in done or u.name in failed)
        progress(over / total, words)

    with _environment(), _pool(jobs) as pool:
        while waiting or running:
            for unit in [u for u in waiting.values() if set(u.needs) & failed.keys()]:
                missing = next(n for n in unit.needs if n in failed)
                failed[waiting.pop(unit.name).name] = f"needs {missing}"
            if time.monotonic() > until:
                waiting.clear()
            for unit in [u for u in waiting.values() if set(u.needs) <= done.keys()]:
                training = sum(_on_gpu(u) for u in running.values())
                if len(running) == jobs:
                    break
                if not _on_gpu(unit) or training < GPU_TRAININGS * gpus:
                    del waiting[unit.name]
                    running[pool.submit(run_unit, out, unit)] = unit
            show(", ".join(sorted(u.name for u in running.values())))
            if not running:
                continue
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                unit = running.pop(future)
                error = future.exception()
                if error is None:
                    done[unit.name] = future.result()
                elif isinstance(error, BrokenProcessPool):
                    raise InputError(
                        f"A process ended during '{unit.name}' (out of memory?); see"
                        f" '{out / unit.name / LOG}' and repeat the command, with fewer --jobs."
                    ) from error
                else:
                    failed[unit.name] = str(error)
                    if not isinstance(error, InputError):  # the others go on; the command ends with an error
                        log = out / unit.name / LOG
                        with log.open("a") as file:
                            file.writelines(traceback.format_exception(error))
                        failed[unit.name] = f"{type(error).__name__}: {error} (see '{log}')"
                        faults.append(unit.name)
    show("")
    return done, failed, faults


def _on_gpu(unit: Unit) -> bool:
    return unit.options.get("device") == "cuda"


def run_unit(out: Path, unit: Unit) -> dict:
    """Carries out one unit; all that this process prints goes to the unit's log. Returns its `unit.json`."""
    folder = out / unit.name
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOG).open("a") as log:
        for stream in (1, 2):  # also what libraries in C print
            os.dup2(log.fileno(), stream)
    from pneutac_benchmarks.policy.units import KINDS

    start = time.monotonic()
    result = KINDS[unit.kind](folder, unit.options, [out / need for need in unit.needs])
    found = {"unit": as_dict(unit), "seconds": time.monotonic() - start, "result": result}
    write_json(folder / RESULT, found)
    return found


@contextlib.contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with this one, and at once when this one fails or is interrupted."""
    pool = process_pool(jobs)
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            process.kill()  # what they had not finished is done again
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _environment() -> Iterator[None]:
    """What the processes find in their environment."""
    before = {k: os.environ.get(k) for k in _ENVIRONMENT}
    os.environ.update(_ENVIRONMENT)
    try:
        yield
    finally:
        for k, v in before.items():
            if v is None:
                del os.environ[k]
            else:
                os.environ[k] = v
