"""A fitted model as the statistics and the reports see it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pneutac_sim.finger.quantities import squared_distance
from pneutac_sim.twin import Twin


@dataclass(kw_only=True)
class FittedModel:
    """What is known of a fit, for all samples.

    Attributes:
        effects: switched on.
        residual: (n, k) measured - model of what the error counts.
        count: parameters fitted.
        twin: with the fitted parameters.
        at_bound: names of parameters stopped by a bound.
        not_identified: parameters that the recording cannot tell, and why.
    """

    effects: tuple[str, ...]
    residual: np.ndarray
    count: int
    twin: Twin
    at_bound: list[str] = field(default_factory=list)
    not_identified: dict[str, str] = field(default_factory=dict)

    @cached_property
    def squared(self) -> np.ndarray:
        """(n,) squared errors."""
        return squared_distance(self.residual)
