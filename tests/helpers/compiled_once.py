"""What numba compiles and keeps is compiled by one process of a run, while the others wait to load it."""

from functools import cache
from pathlib import Path

from filelock import FileLock
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher


def compile_once(folder: Path) -> None:
    """From now on in this process.

    Args:
        folder: for locks, the same in all processes of the run.
    """
    compile_here, lock = Dispatcher.compile, cache(lambda name: FileLock(folder / f"{name}.lock"))

    def compile_or_load(self, signature):
        if not isinstance(self._cache, FunctionCache):
            return compile_here(self, signature)
        # Numba's own lock comes first: else two threads could each hold one and wait for the other.
        with global_compiler_lock, lock(f"{self.py_func.__module__}.{self.py_func.__qualname__}"):
            return compile_here(self, signature)

    Dispatcher.compile = compile_or_load
