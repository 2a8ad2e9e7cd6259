"""A twin's folder under kills, two writers and damage."""

import multiprocessing
import os
import random
from pathlib import Path

import numpy as np

from lerobot_pneutac.verbs.compare import compare
from pneutac_benchmarks.robustness.outcome import Outcome, judge
from pneutac_benchmarks.robustness.recordings import write_whole
from pneutac_benchmarks.robustness.texts import mutated_lines
from pneutac_datasets.recording.recording import Recording
from pneutac_sim import files
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin, Value

FORK = multiprocessing.get_context("fork")
EFFECTS_OF_SAMPLE = ("creep", "valve_lag", "hysteresis", "sensor_offset")


def first(folder: Path) -> Twin:
    """A new twin with one version and an array."""
    twin = Twin.builtin()
    twin.arrays["rest_image"] = np.zeros((4, 4))
    twin.save_version(folder, "first", "bench", {})
    return twin


def second(folder: Path) -> None:
    """Saves one more version with another array."""
    twin = Twin.load(folder)
    twin.arrays["rest_image"] = np.ones((4, 4))
    twin.save_version(folder, "second", "bench", {})


def stopped_at(operation: int, folder: Path) -> None:
    """A process that ends without a word at its n-th operation on files, as SIGKILL would."""
    left = [operation]

    def counted(do):
        def done(*args, **kwargs):
            left[0] -= 1
            if left[0] < 0:
                os._exit(9)
            return do(*args, **kwargs)

        return done

    for owner, names in ((Path, ("replace", "write_text", "write_bytes", "mkdir")), (os, ("fsync", "open"))):
        for name in names:
            setattr(owner, name, counted(getattr(owner, name)))
    second(folder)
    os._exit(0)


def kill_saves(work: Path) -> Outcome:
    """Ends a save at each of its operations on files in turn: the old twin is there or the new one, whole."""
    broken = []
    for operation in range(99):
        folder = work / f"{operation}"
        first(folder)
        process = FORK.Process(target=stopped_at, args=(operation, folder))
        process.start()
        process.join(20)
        problem = _other_than_old_or_new(folder)
        if problem:
            broken.append(f"operation {operation}: {problem}")
        if process.exitcode == 0:
            break
    if not 10 < operation < 98:
        broken.append(f"a save took {operation} operations; the count is wrong")
    return Outcome("SIGKILL at each file operation of saving a twin's version", operation, tuple(broken))


def _other_than_old_or_new(folder: Path) -> str:
    try:
        twin = Twin.load(folder)
    except InputError as e:
        return str(e)
    changes = [e["change"] for e in twin.history]
    if changes not in (["first"], ["first", "second"]):
        return f"its history is {changes}"
    if not (twin.arrays["rest_image"] == len(changes) - 1).all():
        return "its array is another version's"
    for number in range(len(changes)):
        old = files.read_yaml(folder / "history" / f"{number:03d}" / "twin.yaml")
        if len(old["history"]) != number + 1 or not (folder / old["arrays"]).is_file():
            return f"version {number} is torn"
    if changes == ["first"]:
        second(folder)
        if len(Twin.load(folder).history) != 2:
            return "it cannot be saved again"
    return ""


def save_many(folder: Path, name: str, number: int) -> None:
    """Saves so many versions, each on what is there; starts again where another process was faster."""
    kept = 0
    while kept < number:
        try:
            Twin.load(folder).save_version(folder, f"{name} {kept}", "bench", {})
            kept += 1
        except InputError as e:
            if "changed by another process" not in str(e):
                raise


def save_at_once(work: Path, number: int) -> Outcome:
    """Two processes save versions of new twins, up to 50 of each twin, so many in all."""
    broken = []
    for begin in range(0, number, 50):
        each = min(50, number - begin) // 2
        folder = work / f"{begin}"
        first(folder)
        processes = [FORK.Process(target=save_many, args=(folder, name, each)) for name in "ab"]
        for process in processes:
            process.start()
        for process in processes:
            process.join(600)
        history = Twin.load(folder).history
        wanted = sorted(["first", *(f"{n} {k}" for n in "ab" for k in range(each))])
        if any(p.exitcode for p in processes):
            broken.append(f"twin {begin}: a process ended with an error")
        elif sorted(e["change"] for e in history) != wanted:
            broken.append(f"twin {begin}: {len(wanted) - len(history)} versions are lost")
        elif [e["version"] for e in history] != list(range(len(wanted))):
            broken.append(f"twin {begin}: versions are out of order")
    return Outcome("two processes save versions of one twin", number, tuple(broken))


def sample_twin(folder: Path) -> Path:
    """Saves a finger with effects, intervals, a gel and a history."""
    twin = Twin.builtin()
    for name, value in list(twin.parameters.items())[:4]:
        twin.parameters[name] = Value(value.value, (0.9 * value.value, 1.1 * value.value))
    for name in EFFECTS_OF_SAMPLE:
        twin.effects[name] = {p.name: Value(p.default) for p in get_effect(name).parameters}
    twin.save_version(folder, "calibrated", "bench", {"train": 1.0, "heldout": 1.2, "unit": "mm"})
    return folder


def damage_twins(saved: Path, work: Path, number: int, seed: int = 5) -> Outcome:
    """Mutated `twin.yaml`: each is read or refused in a sentence.

    Args:
        saved: folder of the whole twin.
        work: an empty folder.
        number: how many.
        seed: of the damage.
    """
    rng, lines = random.Random(seed), _copied(saved, work)

    def attempt(_: int) -> None:
        (work / "twin.yaml").write_text(mutated_lines(lines, rng))
        twin = Twin.load(work)
        Pipeline.of(twin).theta(twin)
        GelModel.from_twin(twin)

    return judge("`twin.yaml`: mutated", number, attempt)


def _copied(saved: Path, work: Path) -> list[str]:
    for arrays in saved.glob("*.safetensors"):
        (work / arrays.name).write_bytes(arrays.read_bytes())
    return (saved / "twin.yaml").read_text().splitlines()


def compare_damaged_twins(saved: Path, work: Path, number: int, seed: int = 7) -> Outcome:
    """`compare` of mutated twins with a whole recording; arguments as of `damage_twins`."""
    rng, lines = random.Random(seed), _copied(saved, work)
    recording = Recording.load(write_whole(work / "recordings")[0])

    def attempt(_: int) -> None:
        (work / "twin.yaml").write_text(mutated_lines(lines, rng))
        compare(Twin.load(work), recording).to_dict()

    return judge("`compare` with mutated twins", number, attempt)
