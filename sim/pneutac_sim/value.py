"""A number of a twin."""

from dataclasses import dataclass


@dataclass
class Value:
    """A number with its 95 % confidence interval where it was estimated."""

    value: float
    ci95: tuple[float, float] | None = None
