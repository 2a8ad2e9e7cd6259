"""Pieces of work for the tests of executors; processes that have no pytest import them."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.files import write_text


def make(folder: Path, number: int) -> None:
    """Writes numbers drawn by a seed; fails or dies where, by the name of a file, it is asked to."""
    if (folder / f"refuse_{number}").exists():
        raise InputError(f"piece {number} has no seed; give one.")
    if (folder / f"kill_{number}").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    assert os.environ["OMP_NUM_THREADS"] == "1"
    write_text(folder / f"{number}.txt", str(np.random.default_rng([7, number]).random(3)))


def rest(number: int) -> None:
    """Longer than any test waits."""
    time.sleep(400)


def threads() -> list[int]:
    """Of every library of matrix products in this process, and of its material points."""
    import scipy.linalg  # has a library of its own, as NumPy
    from threadpoolctl import threadpool_info

    from pneutac_sim.mpm import runtime

    scipy.linalg.svdvals(np.eye(3))
    runtime.start("cpu")
    return [*(x["num_threads"] for x in threadpool_info()), runtime.ti.cfg.cpu_max_num_threads]
