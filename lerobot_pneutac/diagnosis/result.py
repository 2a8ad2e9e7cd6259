"""What a diagnosis found, whatever the device; report and `result.json` are made from it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lerobot_pneutac.diagnosis.verdict import Evidence, Explained, Mechanism, explained
from pneutac_sim.effects.laws import curvature, family
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
        not_identified: parameters that the recording does not identify, and why.
    """

    effects: tuple[str, ...]
    residual: np.ndarray
    count: int
    twin: Twin
    at_bound: list[str] = field(default_factory=list)
    not_identified: dict[str, str] = field(default_factory=dict)

    @cached_property
    def squared(self) -> np.ndarray:
        return squared_distance(self.residual)


def family_in(twin: Twin, effect: str) -> str:
    """The family of an effect, by the constants that a twin has for it and for its other static curves."""
    constants = {e: {k: v.value for k, v in values.items()} for e, values in twin.effects.items()}
    kind = family(effect, constants.get(effect))
    if not curvature(effect, constants.get(effect, {})):
        return kind
    return "stiffening" if sum(curvature(e, v) for e, v in constants.items()) > 0 else "gain_saturation"


PROFILE = "bend_profile"  # among known causes: the device bends by a profile of its own, which is no effect


SET_UP = (PROFILE, "base_tilt")  # how the body is made and mounted: fitted, but no effect that is missing


@dataclass
class Untested:
    """An effect that this recording cannot test.

    Attributes:
        name: the effect.
        reason: what is missing, a sentence with the remedy.
    """

    name: str
    reason: str


@dataclass
class Tested:
    """One candidate, alone on top of the twin as it is; or an effect of the twin, taken away.

    Attributes:
        name: the effect.
        errors: on the test part, `heldout` among them (from measured pressure where that drives the model).
        reduction: share of the avoidable error that it removes there; None where it was taken away.
        ci95: its interval.
        parameters: name to `{"value", "ci95", "unit"}`.
        tested_by: on what it was fitted.
    """

    name: str
    errors: dict[str, float]
    reduction: float | None
    ci95: tuple[float, float] | None
    parameters: dict
    tested_by: str

    @property
    def heldout(self) -> float:
        return self.errors["heldout"]


@dataclass
class Rival:
    """An effect that could stand in the place of a selected one.

    Attributes:
        effect: the selected one.
        rival: the other.
        difference: held-out mean square error of the rival minus that of the choice, over the choice's.
        fit: the model with the rival instead.
        winner: the model that was chosen.
    """

    effect: str
    rival: str
    difference: float
    fit: FittedModel
    winner: FittedModel


@dataclass
class Contribution:
    """What one term of a model is worth: the model is re-fitted without it and compared on the test part.

    Attributes:
        name: of the effect, or `bend_profile` for a profile of the device's own.
        known: whether it is a known cause, see `Outcome.known`.
        error_without: test error of the model re-fitted without it.
        error_with: test error of the whole model.
        drop: fall of the test mean square error by the term: value, lower 1 % bound, upper 99 % bound.
    """

    name: str
    known: bool
    error_without: float
    error_with: float
    drop: tuple[float, float, float]


@dataclass
class Refits:
    """A twin re-fitted without and with named effects.

    Attributes:
        before: the twin as it is.
        baseline: with the known causes that the recording shows; `before` where there are none.
        after: with these and the named effects.
        known: known causes that were switched on, see `Outcome.known`.
        contributions: what each term adds to all others, the largest first.
        significant: whether the step from `baseline` to `after` is significant in cross-validation.
        doubts: of the named effects, why one may stand in for something else.
        better: another effect that explains significantly more by itself, with which the named ones add
            nothing, with its model; None where there is none.
    """

    before: FittedModel
    baseline: FittedModel
    after: FittedModel
    known: list[str] = field(default_factory=list)
    contributions: list[Contribution] = field(default_factory=list)
    significant: bool = True
    doubts: dict[str, str] = field(default_factory=dict)
    better: tuple[str, FittedModel] | None = None


@dataclass
class Candidate:
    """A model that a search fitted well, and its probability among the others.

    Attributes:
        twin: as fitted.
        terms: effects besides how the device bends; empty where that is all.
        probability: share of the draws of blocks in which it has the least error on what its fit did not see,
            by Laplace's rule.
    """

    twin: Twin
    terms: tuple[str, ...]
    probability: float


@dataclass
class Outcome:
    """Everything that a search found.

    Attributes:
        before: the twin as it is, re-fitted; of a body from the command.
        after: with all effects found.
        ladder: label and model from the start to the end.
        selected: effects that the twin lacks, known causes among them, the most important first.
        known: those of them that the recording shows as a cause (weight, payload, base pose, stretch), and
            `bend_profile` where the device bends by a profile of its own.
        baseline: the twin with the known causes alone, re-fitted; None where there are none.
        contributions: what each term adds to all others, the largest first; of bodies.
        run_terms: what single runs have of their own, no part of the device: `offset`, `gain`, `pressure_kpa`
            and `clock_s` (root mean squares), and `error`, the test error once they are removed; None where
            runs do not differ.
        tested: all candidates, the best first, then effects of the twin.
        rivals: rivals of each selected effect.
        evidence: numbers behind the verdict.
        verdict: one of five.
        seconds: wall time.
        chosen_in: effect to the share of split seeds that chose it.
        base_model: how the device bends before any effect, in numbers.
        contenders: the final model, its nearest others, and last the twin as it is, re-fitted;
            empty for demonstrations.
        mechanisms: what each cause may be, the largest first; empty where nothing was found, where the noise
            was not measured, and for gels and demonstrations, for which nothing is calibrated.
        not_yet: how much more to record where the error falls, but not significantly; else empty.
    """

    before: FittedModel
    after: FittedModel
    ladder: list[tuple[str, FittedModel]]
    selected: list[str]
    tested: list[Tested]
    rivals: list[Rival]
    evidence: Evidence
    verdict: str
    seconds: float
    known: list[str] = field(default_factory=list)
    baseline: FittedModel | None = None
    contributions: list[Contribution] = field(default_factory=list)
    run_terms: dict[str, float] | None = None
    chosen_in: dict[str, float] = field(default_factory=dict)
    base_model: dict = field(default_factory=dict)
    contenders: list[Candidate] = field(default_factory=list)
    mechanisms: list[Mechanism] = field(default_factory=list)
    not_yet: str = ""

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
