"""What a diagnosis found, whatever the device; report and `result.json` are made from it."""

from dataclasses import dataclass, field

from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.verdict import Evidence
from pneutac_sim.twin import Twin


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
        """Error on the test part."""
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
class Contender:
    """A model that a search fitted well, and how likely it is beside the others.

    Attributes:
        twin: as fitted.
        terms: effects beside how the device bends; empty where that is all.
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
        selected: effects found, the most important first.
        tested: all candidates, the best first, then effects of the twin.
        rivals: rivals of each selected effect.
        evidence: numbers behind the verdict.
        verdict: one of five.
        twin: the final model.
        seconds: wall time.
        chosen_in: effect to the share of split seeds that chose it.
        base_model: how the device bends before any effect, in numbers.
        contenders: the final model, its nearest others, and last the twin as it is, re-fitted;
            empty for demonstrations.
        likely_right: probability that the headline is the physics of the device, see `belief`; None where
            nothing was found or the noise is not known, and for gels and demonstrations.
    """

    before: FittedModel
    after: FittedModel
    ladder: list[tuple[str, FittedModel]]
    selected: list[str]
    tested: list[Tested]
    rivals: list[Rival]
    evidence: Evidence
    verdict: str
    twin: Twin
    seconds: float
    chosen_in: dict[str, float] = field(default_factory=dict)
    base_model: dict = field(default_factory=dict)
    contenders: list[Contender] = field(default_factory=list)
    likely_right: float | None = None
