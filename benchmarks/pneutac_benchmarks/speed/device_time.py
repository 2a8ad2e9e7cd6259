"""How long a GPU takes for something, by its own events."""

from collections.abc import Callable

import numpy as np
import torch

WARM, REPEATS = 10, 200


def device_ms(work: Callable[[], object]) -> float:
    """Median milliseconds of `work()` on the current CUDA device, once it is warm."""
    for _ in range(WARM):
        work()
    times = []
    for _ in range(REPEATS):
        begun, done = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begun.record()
        work()
        done.record()
        torch.cuda.synchronize()
        times.append(begun.elapsed_time(done))
    return float(np.median(times))
