"""What a diagnosis found; the report and `result.json` are made from it."""

from dataclasses import dataclass, field

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.candidates import Untested
from lerobot_pneutac.diagnosis.fingerprints import Fingerprint
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.profile import Profile
from lerobot_pneutac.diagnosis.rivals import Rival
from lerobot_pneutac.diagnosis.verdict import Evidence
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin


@dataclass
class Tested:
    """One candidate, alone on top of the twin as it is.

    Attributes:
        name: the effect.
        heldout: error on the test part (from measured pressure where that drives the model).
        reduction: share of the avoidable error that it removes there.
        ci95: its interval.
        parameters: name to `{"value", "ci95", "unit"}`.
        tested_by: on what it was fitted.
    """

    name: str
    heldout: float
    reduction: float
    ci95: tuple[float, float]
    parameters: dict
    tested_by: str


@dataclass
class BodyFindings:
    """Everything that was found; the report and `result.json` are made from it.

    Attributes:
        recording: cleaned.
        findings: sentences of the data check.
        noise: noise floor.
        parts: training, validation, test.
        twin: the final twin.
        base: fit of the twin as it is, from the command.
        before: (n,) residual vectors (n, k) of `base`.
        after: (n, k) residual of the final twin, from the command.
        prediction: (n, k) of the final twin.
        ladder: (label, residual) from the start to the end.
        selected: effects found, the most important first.
        tested: all candidates.
        untested: effects that this recording cannot test.
        prints: fingerprints.
        rivals: rivals of each selected effect.
        correlated: pairs of effects whose parameters the data cannot tell apart (correlation above 0.95).
        profiles: what the recording tells of each parameter of the selected effects.
        evidence: numbers behind the verdict.
        verdict: one of five.
        measured_pressure: whether air and body were told apart by measured pressure.
        pressure_error: error of the modelled pressure before and after, and its noise, kPa.
    """

    recording: Recording
    findings: list[str]
    noise: NoiseFloor
    parts: Parts
    twin: Twin
    base: FittedModel
    before: np.ndarray
    after: np.ndarray
    prediction: np.ndarray
    ladder: list[tuple[str, np.ndarray]]
    selected: list[str]
    tested: list[Tested]
    untested: list[Untested]
    prints: list[Fingerprint]
    rivals: list[Rival]
    correlated: list[tuple[str, str, float]]
    profiles: list[Profile]
    evidence: Evidence
    verdict: str
    measured_pressure: bool
    pressure_error: tuple[float, float, float] | None = None
    seconds: float = 0.0
    judge: Resampler | None = field(default=None, repr=False)

    @property
    def before_error(self) -> float:
        """Error of the twin as it is on the test part."""
        return float(np.sqrt(self.judge.value((self.before**2).sum(1))))

    @property
    def after_error(self) -> float:
        """Error of the final twin on the test part."""
        return float(np.sqrt(self.judge.value((self.after**2).sum(1))))

    @property
    def removed(self) -> tuple[float, tuple[float, float]]:
        """Share of the avoidable error that all found effects remove, with its interval."""
        if not self.selected:
            return 0.0, (0.0, 0.0)
        return self.judge.reduction((self.before**2).sum(1), (self.after**2).sum(1), self.noise.value)
