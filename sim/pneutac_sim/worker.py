"""Processes of a pool."""

import multiprocessing
import os
import sys
import threading


def start_worker() -> None:
    """Begins a worker: it computes on one thread, and ends, with its own processes, when its parent does.

    Else a parent that is killed would leave its workers waiting for ever.
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # for what is imported from here on; PyTorch takes seconds
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)

    def end_with_parent() -> None:
        multiprocessing.parent_process().join()
        for child in multiprocessing.active_children():
            child.kill()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
