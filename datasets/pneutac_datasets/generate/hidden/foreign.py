"""What a hidden effect is, and the registry of all of them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pneutac_datasets.generate.hidden.bench import HiddenBench

# The chain, in order. An effect takes the signal of its stage and returns it changed:
#   command, pressure, drive, material: (n,) kPa on the fine grid;
#   gauge: what the gauge reads (n,) -> the true pressure (n,);
#   load: joint angles (m, 4), rad, of the logged samples -> torque (m, 4), N m, all added up;
#   marker: tip (m, 3), mm, of the logged samples.
STAGES = ("command", "pressure", "gauge", "drive", "material", "load", "marker")


@dataclass(frozen=True)
class Foreign:
    """One hidden effect.

    Attributes:
        name: what it is called in the library, or `disturbance_...` for what no library effect is.
        form: the mathematics, in words.
        stage: where in the chain it acts.
        accepts: library names that are a right answer.
        nominal: start for the search of its size.
        least: size below which a full effect would not be seen as such, whatever its error.
        largest: size that is still physical.
        apply: `(signal, bench, size, rng) -> signal`; the rng is the same at each call for a seed.
    """

    name: str
    form: str
    stage: str
    accepts: tuple[str, ...]
    nominal: float
    least: float
    largest: float
    apply: Callable[[np.ndarray, HiddenBench, float, np.random.Generator], np.ndarray]


REGISTRY: dict[str, Foreign] = {}


def foreign(name, form, stage, accepts=None, nominal=1.0, largest=np.inf, least=0.0):
    """Registers the decorated function as a hidden effect."""

    def add(function):
        if stage not in STAGES or name in REGISTRY:
            raise ValueError(f"hidden effect '{name}' has an unknown stage or is there twice")
        names = (name,) if accepts is None else tuple(accepts)
        REGISTRY[name] = Foreign(name, form, stage, names, nominal, least, largest, function)
        return function

    return add


def is_disturbance(name: str) -> bool:
    """Whether this is outside any library of effects."""
    return name.startswith("disturbance_")
