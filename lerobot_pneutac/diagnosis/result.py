"""What a diagnosis found, whatever the device; report and `result.json` are made from it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lerobot_pneutac.diagnosis.verdict import PROFILE, Evidence, Explained, Mechanism, explained, family_in
from pneutac_sim.finger.quantities import squared_distance
from pneutac_sim.twin import Twin


@dataclass(kw_only=True)
class FittedModel:
    """What is known of a fit, for all samples."""

    effects: tuple[str, ...]  # switched on
    residual: np.ndarray  # (n, k) measured - model of what the error counts
    count: int  # parameters fitted
    twin: Twin  # with the fitted parameters
    at_bound: list[str] = field(default_factory=list)  # names of parameters stopped by a bound
    # parameters that the recording does not identify, and why
    not_identified: dict[str, str] = field(default_factory=dict)

    @cached_property
    def squared(self) -> np.ndarray:
        return squared_distance(self.residual)


CURVE_LIKE = ("base_tilt", "elongation")  # fitted causes that compensate for a missing curve of the pressure
# How the body is made, mounted and read: fitted, but no effect that is missing
SET_UP = (PROFILE, "base_tilt", "curvature_reading")


@dataclass
class Untested:
    """An effect that this recording cannot test."""

    name: str  # the effect
    reason: str  # what is missing, a sentence with the remedy


@dataclass
class Tested:
    """One candidate, alone on top of the twin as it is; or an effect of the twin, taken away."""

    name: str  # the effect
    # on the test part, `heldout` among them (from measured pressure where that drives the model)
    errors: dict[str, float]
    # share of the avoidable error that it removes there; None where it was taken away
    reduction: float | None
    ci95: tuple[float, float] | None  # its interval
    parameters: dict  # name to `{"value", "ci95", "unit"}`
    tested_by: str  # on what it was fitted

    @property
    def heldout(self) -> float:
        return self.errors["heldout"]


@dataclass
class Rival:
    """An effect that could stand in the place of a selected one."""

    effect: str  # the selected one
    rival: str  # the other
    difference: float  # held-out mean square error of the rival minus that of the choice, over the choice's
    fit: FittedModel  # the model with the rival instead
    winner: FittedModel  # the model that was chosen


@dataclass
class Contribution:
    """What one term of a model is worth: the model is re-fitted without it and compared on the test part."""

    name: str  # of the effect, or `bend_profile` for a profile of the device's own
    known: bool  # whether it is a known cause, see `Outcome.known`
    error_without: float  # test error of the model re-fitted without it
    error_with: float  # test error of the whole model
    # fall of the test mean square error by the term: value, lower 1 % bound, upper 99 % bound
    drop: tuple[float, float, float]


@dataclass
class Refits:
    """A twin re-fitted without and with named effects."""

    before: FittedModel  # the twin as it is
    baseline: FittedModel  # with the known causes that the recording shows; `before` where there are none
    after: FittedModel  # with these and the named effects
    known: list[str] = field(default_factory=list)  # known causes that were switched on, see `Outcome.known`
    # what each term adds to all others, the largest first
    contributions: list[Contribution] = field(default_factory=list)
    significant: bool = True  # whether the step from `baseline` to `after` is significant in cross-validation
    # of the named effects, why one may stand in for something else
    doubts: dict[str, str] = field(default_factory=dict)
    # another effect that explains significantly more by itself, with which the named ones add nothing, with
    # its model; None where there is none
    better: tuple[str, FittedModel] | None = None


@dataclass
class Candidate:
    """A model that a search fitted well, and its probability among the others."""

    twin: Twin  # as fitted
    terms: tuple[str, ...]  # effects besides how the device bends; empty where that is all
    # share of the draws of blocks in which it has the least error on what its fit did not see, by Laplace's
    # rule
    probability: float


@dataclass
class Outcome:
    """Everything that a search found."""

    before: FittedModel  # the twin as it is, re-fitted; of a body from the command
    after: FittedModel  # with all effects found
    ladder: list[tuple[str, FittedModel]]  # label and model from the start to the end
    selected: list[str]  # effects that the twin lacks, known causes among them, the most important first
    tested: list[Tested]  # all candidates, the best first, then effects of the twin
    rivals: list[Rival]  # rivals of each selected effect
    evidence: Evidence  # numbers behind the verdict
    verdict: str  # one of five
    seconds: float  # wall time
    # those of them that the recording shows as a cause (weight, payload, base pose, stretch), and
    # `bend_profile` where the device bends by a profile of its own
    known: list[str] = field(default_factory=list)
    # the twin with the known causes alone, re-fitted; None where there are none
    baseline: FittedModel | None = None
    # what each term adds to all others, the largest first; of bodies
    contributions: list[Contribution] = field(default_factory=list)
    # what single runs have of their own, no part of the device: `offset`, `gain`, `pressure_kpa` and
    # `clock_s` (root mean squares), and `error`, the test error once they are removed; None where runs do not
    # differ
    run_terms: dict[str, float] | None = None
    # effect to the share of split seeds that chose it
    chosen_in: dict[str, float] = field(default_factory=dict)
    base_model: dict = field(default_factory=dict)  # how the device bends before any effect, in numbers
    # the final model, its nearest others, and last the twin as it is, re-fitted; empty for demonstrations
    contenders: list[Candidate] = field(default_factory=list)
    # what each cause may be, the largest first; empty where nothing was found, where the noise was not
    # measured, and for gels and demonstrations, for which nothing is calibrated
    mechanisms: list[Mechanism] = field(default_factory=list)
    not_yet: str = ""  # how much more to record where the error falls, but not significantly; else empty

    @property
    def explained(self) -> Explained:
        """How much of the error is explained."""
        return explained(self.evidence)

    @property
    def named(self) -> list[str]:
        """Effects found whose mechanism is more likely right than wrong, and those without a probability."""
        open_ = {m.cause for m in self.mechanisms if not m.named}
        return [e for e in self.selected if e in SET_UP or family_in(self.twin, e) not in open_]

    @property
    def likely_right(self) -> float | None:
        """Probability that the first cause is what was found; None where there are no mechanisms."""
        return self.mechanisms[0].probability if self.mechanisms else None

    @property
    def twin(self) -> Twin:
        return self.after.twin
