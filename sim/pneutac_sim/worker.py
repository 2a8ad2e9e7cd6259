"""Processes of a pool, which end when their parent does, however it does."""

import ctypes
import importlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.reduction import ForkingPickler

PR_SET_PDEATHSIG = 1  # linux/prctl.h


def process_pool(workers: int, begin: Callable | None = None, *args) -> ProcessPoolExecutor:
    """A pool of new processes, each of which computes on one thread and ends within a second of its parent.

    Args:
        workers: number of processes.
        begin: function of a module, called in each process before its first task.
        args: its arguments; they reach it once, as they are sent between processes.
    """
    name = f"{begin.__module__}:{begin.__name__}" if begin else ""
    sent = (name, bytes(ForkingPickler.dumps(args)))
    return ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, sent)


def _begin(name: str, args: bytes) -> None:
    """What a process does first; what else it needs is imported once it can end, since that takes seconds."""
    os.environ["OMP_NUM_THREADS"] = "1"  # for what is imported from here on
    _end_with_parent()
    if name:
        module, _, function = name.partition(":")
        getattr(importlib.import_module(module), function)(*ForkingPickler.loads(args))
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def _end_with_parent() -> None:
    """Has the kernel end this process with its parent on Linux; a thread does elsewhere, and ends children.

    The thread alone would wait for compiled code that keeps Python's lock.
    """
    parent = multiprocessing.parent_process()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent.pid:  # it ended just before
            os._exit(1)

    def wait() -> None:
        parent.join()
        for child in multiprocessing.active_children():
            child.kill()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
