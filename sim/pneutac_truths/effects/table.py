"""The table of effects and how one is entered."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

STAGES = ("command", "air", "drive", "material", "load", "motion", "marker", "gauge")
BODIES = ("rod", "arm", "cosserat")


@dataclass(frozen=True)
class Effect:
    """One departure from the plain device."""

    name: str  # in the table
    summary: str  # what happens, in a line
    physics: bool  # False for a fault of tracker, gauge or mount, which is no physics of the device
    devices: tuple[str, ...]  # to which it applies
    source: str  # from which literature its form and natural range come
    stage: str  # where it acts, one of `STAGES`
    ranges: dict[str, tuple[float, float]]  # parameter to (lowest, highest); `size` decides how strong it is
    act: Callable  # changes a `World`; takes the parameters by name

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Parameters within their ranges, log-uniform where a range is positive; `size` is the middle."""
        out = {}
        for name, (low, high) in self.ranges.items():
            if name == "size":
                out[name] = float(np.sqrt(low * high))
            elif low > 0:
                out[name] = float(np.exp(rng.uniform(np.log(low), np.log(high))))
            else:
                out[name] = float(rng.uniform(low, high))
        return out


EFFECTS: dict[str, Effect] = {}


def described(act: Callable) -> tuple[str, str]:
    """Summary and source of an effect, from the docstring of its function."""
    doc = inspect.getdoc(act) or ""
    return doc.partition("\n")[0], " ".join(doc.partition("Source: ")[2].removesuffix(".").split())


def effect(stage: str, *, physics=True, devices=BODIES, **ranges):
    """Decorator that registers a function under its name, with the first line of its docstring."""

    def enter(act: Callable) -> Callable:
        name, (summary, source) = act.__name__, described(act)
        EFFECTS[name] = Effect(name, summary, physics, devices, source, stage, ranges, act)
        return act

    return enter


def by_column(kernel: Callable) -> Callable:
    """Compiles a kernel that fills one column `out` (n,) from `x` (n,); returns it for all columns (n, c)."""
    compiled = njit(cache=True)(kernel)

    @functools.wraps(kernel)
    def run(x: np.ndarray, *constants) -> np.ndarray:
        out = np.empty_like(x)
        for j in range(x.shape[1]):
            compiled(x[:, j], out[:, j], *constants)
        return out

    return run
