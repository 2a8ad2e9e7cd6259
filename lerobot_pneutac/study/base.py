"""One device's data under judgement: what every kind of device offers to the statistics and to the verbs."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.candidates import Untested
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.steps import Steps
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.twin import Twin


class Study(ABC):
    """A twin beside a recording: a sample is a row of a body's recording or a photograph of a gel.

    Attributes:
        twin: as it was given.
        recording: checked.
        seed: decides the parts and every bootstrap.
        unit: of the error.
        noise: error that the measurement's own noise makes.
        parts: train fits parameters, validation decides what is kept, test is looked at by reports alone.
        own: effects that the twin has.
        candidates: effects to try.
        untested: effects that this recording cannot test.
        findings: of the checks, one sentence each.
    """

    twin: Twin
    recording: Recording
    seed: int
    unit: str
    noise: NoiseFloor
    parts: Parts
    own: tuple[str, ...]
    candidates: list[str]
    untested: list[Untested]
    findings: list[str]

    @abstractmethod
    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """All parameters of the twin and of these effects, fitted to the training part.

        Args:
            effects: all that shall be on.
            start: a model to begin from; the twin where None.
            steps: counts the fit.
        """

    @abstractmethod
    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on, a sentence; empty where it can."""

    @abstractmethod
    def twin_of(self, model: FittedModel) -> Twin:
        """The twin as it is to be written."""

    @abstractmethod
    def parameters(self, model: FittedModel, effect: str) -> dict[str, dict]:
        """Parameters of one effect: name to `value`, `ci95` and `unit`."""

    @abstractmethod
    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        """Parameters stopped by a bound."""

    @cached_property
    def judge(self) -> Resampler:
        """Resamples the validation part."""
        return Resampler(self.parts.validation, self.parts.unit, self.parts.stratum, self.seed)

    @cached_property
    def test(self) -> Resampler:
        """Resamples the test part."""
        return Resampler(self.parts.test, self.parts.unit, self.parts.stratum, self.seed + 1)

    def errors(self, model: FittedModel) -> dict:
        """Root mean square errors: `train`, `heldout` (the test part) and its interval `heldout_ci95`."""
        low, high = np.sqrt(np.quantile(self.test.mse(model.squared), [0.025, 0.975]))
        return {
            "train": float(np.sqrt(model.squared[self.parts.train].mean())),
            "heldout": float(np.sqrt(self.test.value(model.squared))),
            "heldout_ci95": [float(low), float(high)],
        }

    def describe(self, model: FittedModel, effect: str) -> str:
        """What an effect does to this device, a sentence with the fitted numbers."""
        values = {k: p["value"] for k, p in self.parameters(model, effect).items()}
        return get_effect(effect).describe(values, self.recording.device)

    def already_on(self, effect: str) -> str:
        """A sentence where the twin has this effect."""
        if effect not in self.own:
            return ""
        return (
            f"The twin has the effect '{effect}' already (it has {', '.join(self.own)}); "
            "`pneutac calibrate` re-fits it."
        )


def study_of(twin: Twin, recording: Recording, seed: int = 0, adding: str | None = None) -> Study:
    """The study of a recording by its device.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel.
        seed: decides the parts and every bootstrap.
        adding: the one effect that is to be tried; None where all are.

    Raises:
        InputError: there is too little to fit or to judge by.
    """
    if recording.device == "gel":
        from lerobot_pneutac.study.gel import GelStudy

        return GelStudy(twin, recording, seed)
    from lerobot_pneutac.study.body import BodyStudy

    return BodyStudy(twin, recording, seed, adding)
