"""The one place that loads the kernel compiler and starts it on a device.

Taichi compiles the kernels; where only its maintained fork `quadrants` is installed, that does. Kernels
import `ti` from here and keep to what both can do.
"""

import atexit
import contextlib
import dataclasses
import io
import multiprocessing
import os
import warnings

from pneutac_sim.errors import InputError, check_choice

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")  # it greets on stdout, where results go
with warnings.catch_warnings():  # of an escape in one of Taichi's own docstrings
    warnings.simplefilter("ignore", SyntaxWarning)
    try:
        import taichi as ti
    except ImportError:
        import quadrants as ti

_started: tuple[str, int] | None = None  # device and process


def start(device: str = "auto") -> str:
    """Starts the compiler's runtime once a process, on `cpu`, `cuda`, or `auto` for CUDA where there is one.

    On the CPU it computes on all cores, and in a process of a pool on one: the others are busy, and several
    add numbers in any order. Returns `cpu` or `cuda`; later calls with the same device do nothing else.

    Raises InputError: no such device, CUDA is missing, the runtime runs on another device already, or this
    process was forked from one in which it had been started (it would hang).
    """
    global _started
    check_choice("device", device, ("auto", "cpu", "cuda"))
    if _started is not None:
        running, process = _started
        if process != os.getpid():
            raise InputError(
                "This process was forked after the MPM runtime had been started, which makes it hang; "
                "start processes with multiprocessing.get_context('spawn')."
            )
        if device not in ("auto", running):
            raise InputError(f"The MPM runtime runs on {running} already; {device} needs a new process.")
        return running
    ti.set_logging_level(ti.ERROR)  # without a GPU the search for one would warn
    if device == "auto":
        device = "cuda" if _has_cuda() else "cpu"
    elif device == "cuda" and not _has_cuda():
        raise InputError(
            "CUDA is not available: `nvidia-smi` must list a GPU, with a driver of version 450 or newer; "
            "use the device cpu."
        )
    options = {"default_fp": ti.f32, "offline_cache": True, "log_level": ti.ERROR}
    if device == "cpu":
        alone = multiprocessing.parent_process() is None
        options["cpu_max_num_threads"] = multiprocessing.cpu_count() if alone else 1
    with contextlib.redirect_stdout(io.StringIO()):  # a greeting has no place among results
        ti.init(arch=ti.cuda if device == "cuda" else ti.cpu, **options)
    if hasattr(ti, "ArgPack"):  # at exit a pack would look for the runtime, which has gone by then
        atexit.register(delattr, ti.ArgPack, "__del__")
    _started = (device, os.getpid())
    return device


def struct(**members):
    """A type that bundles arrays and numbers into one argument, as a kernel and as a function declare it.

    Taichi has argument packs, which its functions take as templates; its fork has dataclasses.
    """
    if hasattr(ti.types, "argpack"):
        return ti.types.argpack(**members), ti.template()
    both = dataclasses.make_dataclass("Struct", members.items())
    return both, both


def _has_cuda() -> bool:
    if os.environ.get("CUDA_VISIBLE_DEVICES") in ("", "-1"):  # Taichi sees the driver alone
        return False
    with_arch = getattr(ti._lib.core, "with_cuda", None)
    return bool(with_arch and with_arch())
