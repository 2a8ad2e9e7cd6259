"""A killed parent of worker processes, as `pneutac augment` is one: how long the workers outlive it."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from pneutac_benchmarks.robustness.outcome import Outcome
from pneutac_sim.executor import process_pool

MOST_S = 1.0
WORKERS = 2


def busy(_: int) -> None:
    """Writes its process' number, then holds Python's lock for a minute, as compiled code may."""
    os.write(1, f"{os.getpid()}\n".encode())  # in one piece
    ctypes.PyDLL(None).sleep(60)


def parent() -> None:
    """Runs a pool whose workers compute."""
    with process_pool(WORKERS) as pool:
        list(pool.map(busy, range(WORKERS)))


def kill_parents(number: int) -> Outcome:
    """Kills a parent so many times while its workers compute."""
    broken, longest = [], 0.0
    for i in range(number):
        program = "from pneutac_benchmarks.robustness.killed_parent import parent; parent()"
        process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        workers = [int(process.stdout.readline()) for _ in range(WORKERS)]
        time.sleep(0.1)
        process.kill()
        killed = time.monotonic()
        while any(map(_runs, workers)) and time.monotonic() < killed + 10:
            time.sleep(0.01)
        longest = max(longest, time.monotonic() - killed)
        process.wait()
        process.stdout.close()
        if time.monotonic() - killed > MOST_S:
            broken.append(f"{i}: workers were there for {time.monotonic() - killed:.1f} s")
        for worker in filter(_runs, workers):
            os.kill(worker, signal.SIGKILL)
    return Outcome(
        "SIGKILL of the parent of workers that keep Python's lock, as `augment`'s may",
        number,
        tuple(broken),
        f"the last worker ended after {longest:.2f} s",
    )


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
