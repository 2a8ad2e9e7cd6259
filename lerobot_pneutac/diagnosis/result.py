"""What a diagnosis found, whatever the device; report and `result.json` are made from it."""

from dataclasses import dataclass, field

from lerobot_pneutac.diagnosis.fingerprints import Fingerprint
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.profile import Profile
from lerobot_pneutac.diagnosis.rivals import Rival
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
class Outcome:
    """Everything that a search found.

    Attributes:
        before: the twin as it is, re-fitted; of a body from the command.
        after: with all effects found.
        ladder: label and model from the start to the end.
        selected: effects found, the most important first.
        tested: all candidates, the best first, then effects of the twin.
        rivals: rivals of each selected effect.
        correlated: pairs of effects whose parameters the data cannot tell apart (correlation above 0.95).
        evidence: numbers behind the verdict.
        verdict: one of five.
        twin: the final model.
        seconds: wall time.
        fingerprints: how effects would show in what is left of the twin as it is.
        profiles: what the recording tells of each parameter of the selected effects.
        pressure_error: error of the modelled pressure before and after, and its noise, kPa, where pressure
            was measured.
    """

    before: FittedModel
    after: FittedModel
    ladder: list[tuple[str, FittedModel]]
    selected: list[str]
    tested: list[Tested]
    rivals: list[Rival]
    correlated: list[tuple[str, str, float]]
    evidence: Evidence
    verdict: str
    twin: Twin
    seconds: float
    fingerprints: list[Fingerprint] = field(default_factory=list)
    profiles: list[Profile] = field(default_factory=list)
    pressure_error: tuple[float, float, float] | None = None
