"""Recordings that several tests, or several processes of tests, want are generated once in a run."""

import hashlib
import inspect
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

from filelock import FileLock

import pneutac_datasets
import pneutac_sim
import pneutac_truths
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin

FOLDER = "PNEUTAC_TEST_RECORDINGS"  # of the run; `conftest.py` makes it before the processes part


def once(make: Callable, *args, **options) -> Recording:
    """What a generator writes, copied from the first time that this run asked for the same.

    Args:
        make: a function with an argument `folder` or `out`, where it writes, and `truth/NAME.json` beside it.
        args: its arguments.
        options: its arguments by name.
    """
    given = inspect.signature(make).bind(*args, **options)
    given.apply_defaults()
    name = "folder" if "folder" in given.arguments else "out"
    folder = Path(given.arguments.pop(name))
    key = f"{make.__module__}.{make.__qualname__} {sorted(given.arguments.items())!r} {_sources()}"
    made = Path(os.environ[FOLDER]) / hashlib.sha256(key.encode()).hexdigest()[:16]
    with FileLock(f"{made}.lock"):
        if not made.exists():
            half = made.with_suffix(".half")
            shutil.rmtree(half, ignore_errors=True)
            make(**given.arguments, **{name: half / "recording"})
            half.rename(made)
    shutil.copytree(made / "recording", folder, dirs_exist_ok=True)
    if (made / "truth").exists():
        (folder.parent / "truth").mkdir(exist_ok=True)
        for file in (made / "truth").iterdir():
            shutil.copy(file, folder.parent / "truth" / file.name.replace("recording", folder.name, 1))
    return Recording.load(folder)


def twin_of(recording: Recording) -> Twin:
    """A plain twin of a recording's device."""
    return Twin(recording.device, recording.length_mm, recording.spine_joint_positions_mm)


@cache
def _sources() -> str:
    """Hash of all the code that generated recordings come from."""
    digest = hashlib.sha256()
    for package in (pneutac_datasets, pneutac_sim, pneutac_truths):
        for file in sorted(Path(package.__file__).parent.rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()
