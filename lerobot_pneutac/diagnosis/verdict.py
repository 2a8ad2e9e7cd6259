"""The five verdicts.

adequate            nothing but noise is left
missing_effect      effects were found and explain what could be explained
insufficient_form   effects were found and explain most of it, but more than noise is left
unknown_effect      most of what could be explained is explained by no effect of the library
ambiguous           this recording cannot tell
"""

from dataclasses import dataclass

MOST = 0.5  # share of the avoidable error that effects must remove to carry the headline
FEW_UNITS = 6  # held-out pieces of time below which no bootstrap means much
FEW_SAMPLES = 60
SMALL_LEFTOVER = 0.12  # share of the avoidable error that may stay without a word on the form


@dataclass
class Evidence:
    """What the verdict rests on.

    Attributes:
        samples: number of training samples.
        units: number of held-out pieces of time, or of photographs.
        moves: whether the pressure moves at all.
        before: held-out error over the noise floor, the twin as it is.
        after: the same with the selected effects.
        limit: largest such ratio that noise explains.
        selected: effects found, the most important first.
        removed: share of the avoidable error that they remove together.
        at_bound: parameters of selected effects at a bound.
        near_miss: effects that helped, but not for sure.
        few_samples: training samples below which nothing can be claimed; a photograph is worth many rows.
    """

    samples: int
    units: int
    moves: bool
    before: float
    after: float
    limit: float
    selected: list[str]
    removed: float
    at_bound: list[str]
    near_miss: list[str]
    few_samples: int = FEW_SAMPLES

    @property
    def poor(self) -> bool:
        """Whether the recording is too poor for any claim."""
        return not self.moves or self.samples < self.few_samples or self.units < FEW_UNITS


def decide(e: Evidence) -> str:
    """The verdict."""
    if e.poor:
        return "ambiguous"
    if not e.selected:
        if e.before <= e.limit:
            return "adequate"
        return "ambiguous" if e.near_miss else "unknown_effect"
    if e.after <= e.limit:
        return "missing_effect"
    if e.removed < MOST:
        return "unknown_effect"
    return "insufficient_form" if e.at_bound or 1 - e.removed > SMALL_LEFTOVER else "missing_effect"
