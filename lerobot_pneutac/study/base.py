"""One device's data under judgement: what every kind of device offers to the statistics and to the verbs."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.black_box import share_left
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, PairedTest, Parts
from lerobot_pneutac.diagnosis.design import Separation
from lerobot_pneutac.diagnosis.result import (
    Contribution,
    FittedModel,
    Outcome,
    Refits,
    Rival,
    Tested,
    Untested,
)
from lerobot_pneutac.diagnosis.search import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence, called, decide, hardly_bends
from pneutac_datasets.recording.axes import motion
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.twin import Twin, Value

SIGNED = ("gain_rad_per_kpa",)  # parameters whose sign must be known


def with_unit(value: Value, unit: str) -> dict:
    return {"value": value.value, "ci95": list(value.ci95) if value.ci95 else None, "unit": unit}


def not_identifiable(value: float, ci95: Sequence[float] | None, spec: Parameter, range_kpa: float) -> bool:
    """Whether an interval is uninformative: it covers the allowed range, or leaves size or sign open.

    It is None where the value was not fitted; `range_kpa` is the largest pressure of the device.
    """
    if ci95 is None:
        return False
    (low, high), (_, lower, upper) = ci95, spec.limits(range_kpa)
    covered = np.log(high / max(low, lower)) / np.log(upper / lower) if spec.log and low > 0 else (
        (high - low) / (upper - lower)
    )  # fmt: skip
    open_size = lower >= 0 and low <= lower and high > T.TIMES * abs(value) > 0
    return bool(covered > T.SPANS or open_size or (spec.name in SIGNED and low < 0 < high))


def unidentified(experiment: str) -> str:
    """The note of a parameter that a recording does not show."""
    return f"not identifiable from this recording: {experiment[:1].lower()}{experiment[1:].rstrip('.')}"


def experiment_of(effect: str, recording: Recording) -> str:
    """What to record to distinguish an effect from its alternatives, beyond what a recording has."""
    if has := _recorded_already(effect, recording):
        return f"This recording has {has} already: another day, by other programs, decides."
    return get_effect(effect).experiment


QUICK = ("air_resonance", "dead_time")  # effects that the measured pressure shows at `QUICK_HZ`
GAUGED = ("valve_lag", "valve_slew", "orifice_flow")  # those that it shows at any rate


def _recorded_already(effect: str, recording: Recording) -> str:
    """What a recording has of an effect's own experiment; empty where something of it is missing."""
    if not isinstance(recording, Recording):
        return ""  # these are experiments on the bench: demonstrations and pictures of a gel have none
    s, gravity = recording.samples, [f"gravity_{a}" for a in "xyz"]
    if effect == "gravity" and all(map(recording.has, gravity)):
        ways = np.unique(np.round(s[gravity].to_numpy(float), 1), axis=0)
        return "opposite directions of gravity" if (ways @ ways.T).min() < -0.5 else ""
    if effect == "payload" and recording.has("payload_g"):
        masses = np.unique(np.round(recording.column("payload_g")))
        return f"{masses[masses > 0].size} masses at the tip" if (masses > 0).sum() > 1 else ""
    if effect == "thermal" and recording.has("temperature_c"):
        low, high = recording.column("temperature_c").min(), recording.column("temperature_c").max()
        return f"temperatures from {low:.0f} to {high:.0f} °C" if high - low >= T.TEMPERATURES_C else ""
    if effect not in (*QUICK, *GAUGED, "creep", "leak"):
        return ""
    if not all(recording.has(c.replace("cmd_", "")) for c in recording.pressure_columns):
        return ""
    if effect in ("creep", "leak"):
        held_s = float(motion(recording)[1].max())
        return f"a hold of {held_s:.0f} s with the measured pressure" if held_s >= T.LONG_HOLD_S else ""
    hz = 1 / float(np.median(np.diff(recording.column("time_s"))))
    return f"the measured pressure at {hz:.0f} Hz" if effect in GAUGED or hz >= T.QUICK_HZ else ""


class EffectStudy(ABC):
    """A recording of one device in which effects can be found: of markers and angles, or of a gel's images.

    A sample is a row of a body's recording, a photograph, or a frame of demonstrations.
    """

    twin: Twin  # as it was given
    recording: Recording  # checked
    seed: int = 0  # decides the parts and every bootstrap
    unit: str  # of the error
    noise: NoiseFloor  # error that the measurement's own noise makes
    more_data: str  # what to record where there is too little
    repeat: str  # what to record where nothing explains the error
    nothing_left: str  # what to say where nothing needs to be recorded
    parts: Parts  # train fits parameters, validation decides what stays, test is used by reports only
    twin_effects: Sequence[str] = ()  # effects that the twin has
    candidates: Sequence[str] = ()  # effects to try
    untested: Sequence[Untested] = ()  # effects that this recording cannot test
    excluded: Sequence[str] = ()  # effects that are no part of any line or base that a search tries by itself
    findings: Sequence[str] = ()  # of the checks, one sentence each

    @property
    def given_rows(self) -> int:
        """Rows, photographs or frames of the recording as it was given."""
        return len(self.recording)

    @cached_property
    def bootstrap(self) -> BlockBootstrap:
        """Resamples the validation part."""
        return BlockBootstrap(self.parts.validation, self.parts.unit, self.parts.stratum, self.seed)

    @cached_property
    def test(self) -> BlockBootstrap:
        """Resamples the test part."""
        return BlockBootstrap(self.parts.test, self.parts.unit, self.parts.stratum, self.seed + 1)

    @property
    def across_trials(self) -> BlockBootstrap:
        """Resamples whole trials of the test part; its units where there are none."""
        return self.test

    @abstractmethod
    def amount_recorded(self) -> tuple[float, str, str]:
        """How much was recorded, the noun that it counts, and of what."""

    def more_to_show(self, fall: PairedTest) -> str:
        """How much more of the same makes such a fall significant with a power of `thresholds.POWER`."""
        amount, noun, what = self.amount_recorded()
        more = amount * max(fall.times - 1, T.LEAST_MORE)
        digits = 10.0 ** max(math.floor(math.log10(more)) - 1, 0)
        return f"{plural(int(math.ceil(more / digits) * digits), f'more {noun}')} {what}"

    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """All parameters of twin and effects, fitted to the training part; begins at `start` or the twin."""
        raise NotImplementedError

    def residual(self, twin: Twin) -> np.ndarray:
        """(n, k) measured minus predicted by another twin of this device; a gel's has an image a row instead.

        Raises:
            InputError: it is a gel's.
        """
        raise InputError(
            "What a gel's diagnosis found is added by name; give --effect=A,B in place of --from."
        )

    @abstractmethod
    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on, a sentence; empty where it can."""

    @abstractmethod
    def twin_of(self, model: FittedModel) -> Twin:
        """The twin as it is to be written."""

    def parameters(self, model: FittedModel, effect: str) -> dict[str, dict]:
        """Parameters of one effect: name to `value`, `ci95` and `unit`."""
        specs = {p.name: p for p in get_effect(effect).parameters}
        values = model.twin.effects.get(effect, {})
        found = {k: with_unit(v, specs[k].unit if k in specs else "") for k, v in values.items()}
        largest = float(self.recording.samples[list(self.recording.pressure_columns)].to_numpy(float).max())
        for k, p in found.items():
            if k in specs and not_identifiable(p["value"], p["ci95"], specs[k], max(largest, 1e-9)):
                p["note"] = unidentified(experiment_of(effect, self.recording))
        return found

    @abstractmethod
    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        """Parameters stopped by a bound."""

    @abstractmethod
    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for what the twin lacks, in so many processes."""

    @abstractmethod
    def too_little(self) -> str:
        """Why the recording is too poor for any claim, a sentence; empty where it is not."""

    def refits(self, effects: Sequence[str], steps: Steps) -> Refits:
        """The twin re-fitted as it is and with these effects, and what each adds to the others."""
        before = self.refit(self.twin_effects, None, steps)
        after = self.refit((*self.twin_effects, *effects), before, steps)
        significant = self.significant(before, after)
        without = dict.fromkeys(effects, before)
        for e in effects if len(effects) > 1 else ():
            without[e] = self.refit(
                (*self.twin_effects, *(o for o in effects if o != e)), before, Steps(None)
            )
        error = self.errors(after)["heldout"]
        contributions = [
            Contribution(e, False, self.errors(m)["heldout"], error, self.test.drop(m.squared, after.squared))
            for e, m in without.items()
        ]
        contributions.sort(key=lambda c: -c.drop[0])
        return Refits(before, before, after, contributions=contributions, significant=significant)

    def significant(self, before: FittedModel, after: FittedModel) -> bool:
        """Whether the error falls significantly on the validation part."""
        return self.bootstrap.drop(before.squared, after.squared)[1] > 0

    # ---------------------------------------------------------------- what a search ended with

    def signals(self) -> np.ndarray | None:
        """(n, f) causal signals from which a black box predicts what a model leaves; None for none."""
        return None

    def removed(self, worst: float, left: float, floor: float) -> float:
        """Share of the excess of a mean square error that went; 0 where nothing was avoidable."""
        avoidable = worst > (1 + T.AVOIDABLE) * floor**2
        return 1 - max(left - floor**2, 0.0) / (worst - floor**2) if avoidable else 0.0

    def evidence(
        self,
        before: FittedModel,
        after: FittedModel,
        selected: list[str],
        chosen_in: Mapping[str, float],
        floor: float | None = None,
        worst: float | None = None,
        left: np.ndarray | None = None,
        **more: Any,
    ) -> Evidence:
        """What the verdict rests on: errors of the test part, which nothing was fitted or chosen on.

        Args:
            before: the twin as it is, re-fitted.
            after: with what was found.
            selected: effects found, the most important first.
            chosen_in: share of the votes of each.
            floor: of the noise, where it is not the study's.
            worst: mean square error to begin with, where it is not that of `before`.
            left: (n,) squared errors that are left, where they are not those of `after`.
            more: further fields.
        """
        floor = self.noise.floor if floor is None else floor
        worst = self.test.value(before.squared) if worst is None else worst
        squared = after.squared if left is None else left
        rest = self.test.value(squared)
        low, high = self._interval(squared)
        known, signals, parts = self.noise.value is not None, self.signals(), self.parts
        return Evidence(
            poor=bool(self.too_little()),
            before=float(np.sqrt(worst)) / floor if known else None,
            after=float(np.sqrt(rest)) / floor if known else None,
            interval=(low / floor, high / floor) if known else None,
            selected=selected,
            removed=float(np.clip(self.removed(worst, rest, floor), -1, 1)) if selected else 0.0,
            at_bound=[n for n in self.at_bound(after, selected) if n.rpartition(".")[0] in selected],
            left_to_black_box=0.0
            if signals is None
            else share_left(after.residual, signals, parts.learnt, parts.test, floor),
            agreed=min((chosen_in.get(t, 1.0) for t in selected[:1]), default=1.0),
            noise_known=self.noise.known,
            **more,
        )

    def alone(
        self, name: str, model: FittedModel, ground: FittedModel, how: str, instance: str = ""
    ) -> Tested:
        """What one effect does alone on a ground model; `instance`: its name in the model."""
        share, interval = self.reduction(ground, model)
        values = self.parameters(model, instance or name)
        return Tested(name, self.tested_errors(model), share, interval, values, how)

    def tested_errors(self, model: FittedModel) -> dict[str, float]:
        """The errors that are reported of each candidate."""
        return {"heldout": float(np.sqrt(self.test.value(model.squared)))}

    def outcome(
        self, began: float, before: FittedModel, after: FittedModel, evidence: Evidence, **found: Any
    ) -> Outcome:
        """What a search ended with; `began` by `time.perf_counter`, `found`: further fields."""
        return Outcome(
            before=before,
            after=after,
            selected=evidence.selected,
            evidence=evidence,
            verdict=decide(evidence),
            seconds=time.perf_counter() - began,
            **found,
        )

    def errors(self, model: FittedModel) -> dict[str, float]:
        """Root mean square errors: `train`, and `heldout`, which is the test part."""
        return {
            "train": root_mean(model.squared[self.parts.train]),
            "heldout": float(np.sqrt(self.test.value(model.squared))),
        }

    def prepare(self, selected: Sequence[str], breaks: Sequence[dict]) -> None:
        """Takes over effects and data breaks of a written diagnosis, where its errors depend on them."""
        return

    def noted(self, model: FittedModel) -> dict:
        """What a twin's history stores of a model besides its errors."""
        return {}

    def interval(self, model: FittedModel) -> list[float]:
        """95 % interval of the held-out error."""
        return list(self._interval(model.squared))

    def _interval(self, squared: np.ndarray) -> tuple[float, float]:
        low, high = np.sqrt(np.quantile(self.test.mse(squared), [0.025, 0.975]))
        return float(low), float(high)

    def reduction(self, before: FittedModel, after: FittedModel) -> tuple[float, tuple[float, float]]:
        """Share of the avoidable error of the test part that went, and its 95 % interval."""
        return self.test.reduction(before.squared, after.squared, self.noise.floor)

    def describe(self, model: FittedModel, effect: str) -> str:
        """What an effect does to this device, a sentence with the fitted numbers."""
        values = {k: p["value"] for k, p in self.parameters(model, effect).items()}
        return get_effect(effect).describe(values, self.recording.device)

    def cause(self, model: FittedModel, effect: str) -> str:
        """What is missing, by the one name of it, with the fitted numbers."""
        values = {k: p["value"] for k, p in self.parameters(model, effect).items()}
        _, comma, numbers = get_effect(effect).as_cause(values, self.recording.device).partition(", ")
        if weak := hardly_bends(model.twin, effect):
            return f"{called(effect, model.twin)}: {weak}"
        return called(effect, model.twin) + comma + numbers

    def size(self, model: FittedModel, effect: str) -> str:
        """How much an effect moves the device, a sentence; empty where that is not known."""
        return ""

    @property
    def recorded(self) -> str:
        """The range of conditions of the recording, for which a diagnosis holds; empty where all are one."""
        return ""

    def confusable_with(self, effects: Sequence[str]) -> str:
        """What this kind of recording cannot separate from effects, a sentence; empty if nothing."""
        return ""

    def experiment(self, model: FittedModel, effect: str) -> str:
        """What to record to distinguish an effect from its alternatives, and what that decides."""
        return experiment_of(effect, self.recording)

    def idle(self, model: FittedModel, effect: str) -> bool:
        """Whether an effect's constants ended where it does nothing to this device."""
        return False

    def already_on(self, effect: str) -> str:
        """A sentence where the twin has this effect."""
        if effect not in self.twin_effects:
            return ""
        return (
            f"The twin has the effect '{effect}' already (it has {', '.join(self.twin_effects)}); "
            "`pneutac calibrate` re-fits it."
        )

    def caveats(self, outcome: Outcome) -> list[str]:
        """What the reader must know besides the verdict."""
        return []

    def to_log(self, outcome: Outcome) -> str:
        """What to log before anything else decides, a sentence; empty where nothing is missing."""
        return ""

    def how_tested(self, outcome: Outcome) -> str:
        """On what the candidates were tried."""
        return ""

    def separation(self, rival: Rival) -> Separation | None:
        """The experiment that separates two models best, where one can be computed."""
        return None

    def as_written(self, parameters: dict[str, dict]) -> dict:
        """Parameters as a diagnosis' `result.json` has them."""
        return parameters

    def details(self, outcome: Outcome) -> dict:
        """What `result.json` has for this device only."""
        return {}

    def pictures(self, outcome: Outcome) -> list[tuple[np.ndarray, str]]:
        """Pictures for the report, uint8 (H, W, 3), with what they show."""
        return []
