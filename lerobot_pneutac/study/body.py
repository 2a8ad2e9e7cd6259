"""A recording of a finger or an arm under judgement; a sample is a row."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lerobot_pneutac.diagnosis import pneumatics
from lerobot_pneutac.diagnosis.candidates import sort_candidates
from lerobot_pneutac.diagnosis.engine import Engine, StageFitter
from lerobot_pneutac.diagnosis.experiment import Separation, predict, separations
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.diagnosis.rivals import Rival
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.body_search import search_body
from lerobot_pneutac.study.pair import LONGER, enough_rows
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import body_effects, get_effect, of_body
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin

REPEAT = "Run the same program twice, an hour apart: what comes back is the device, what does not is the lab."


class BodyStudy(EffectStudy):
    """Markers, angles or curvatures of a finger or an arm.

    Args:
        twin: of the recording's device.
        recording: of a finger or an arm.
        seed: decides the parts and every bootstrap.
        adding: the one effect that is to be tried; None where all are.

    Attributes:
        measured: columns of measured pressure, empty where it tells nothing.

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """

    unknown_where = "moves your {device}"
    more_data, repeat = LONGER, REPEAT
    nothing_left = "Nothing needs to be recorded; go to higher pressure to find where the twin ends."

    def __init__(self, twin: Twin, recording: Recording, seed: int = 0, adding: str | None = None):
        self.twin, self.seed = twin, seed
        self.recording, self.findings = check(recording)
        self.parts = deal(self.recording, seed, choose=adding is None)
        self.own = tuple(of_body(twin.effects))
        self.candidates, self.untested = sort_candidates(self.recording, twin)
        if adding is not None and self.refusal(adding):
            return
        largest = max(self.candidates, key=lambda e: len(get_effect(e).parameters), default=None)
        tried = adding or largest
        enough_rows(twin, self.recording, [*self.own, *([tried] if tried else [])], self.parts.train)
        self.recording, moved = on_one_mount(self.recording, twin, self.parts.train)
        self.findings = self.findings + moved
        self.noise = noise_floor(self.recording)
        self.unit = self.noise.unit
        self.measured = pneumatics.measured_columns(self.recording)
        self._command = BodyData.of(self.recording, twin, source="command")

    def residual(self, model: Twin) -> np.ndarray:
        """(n, k) measured minus predicted from the commanded pressure."""
        data = self._command
        return data.measured[:, : data.counted] - predict(model, data)[0]

    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """Air is fitted to the measured pressure, the body to the pose."""
        new = [e for e in effects if start is not None and e not in start.effects]
        twin = self.twin if start is None or any(map(pneumatics.is_pneumatic, new)) else start.twin
        air_names = tuple(e for e in effects if pneumatics.is_pneumatic(e))
        train = self.parts.train
        if not self.measured or not air_names:
            with Engine(self.recording, train, 1, steps.done) as engine:
                fits = StageFitter(engine, twin, "pose", "command").fit_all([tuple(effects)])
            fitted = fits[0].twin
        else:
            with Engine(self.recording, train, 1, steps.done) as engine:
                air = StageFitter(engine, twin, "pressure", "command").fit_all([air_names])[0]
            with Engine(self.driven(air.residual), train, 1, steps.done) as engine:
                names = tuple(e for e in effects if not pneumatics.is_pneumatic(e))
                body = StageFitter(engine, twin, "pose", "measured").fit_all([names])[0]
            fitted, fits = pneumatics.joined(body.twin, air.twin), [air, body]
        return FittedModel(
            effects=tuple(effects),
            residual=self.residual(fitted),
            count=sum(f.count for f in fits),
            twin=fitted,
            at_bound={k: v for f in fits for k, v in f.at_bound.items()},
            not_identified={k: v for f in fits for k, v in f.not_identified.items()},
        )

    def driven(self, air_residual: np.ndarray) -> Recording:
        """The recording with the best guess of the true pressure, see `pneumatics.driven_by`."""
        return pneumatics.driven_by(self.recording, self.measured, air_residual, self.air_noise)

    @property
    def air_noise(self) -> float:
        """Noise of the measured pressure, kPa."""
        return pneumatics.sensor_noise(self.recording, self.measured)

    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for what the twin lacks."""
        return search_body(self, jobs, steps)

    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on."""
        if effect not in body_effects():
            return f"'{effect}' does not bend a body; give one of {', '.join(body_effects())}."
        untested = {u.name: f"{self.recording.folder}: effect '{effect}' {u.reason}." for u in self.untested}
        return self.already_on(effect) or untested.get(effect, "")

    def twin_of(self, model: FittedModel) -> Twin:
        """The fitted body with the gel, pictures and networks of the twin that was given."""
        kept = {k: v for k, v in self.twin.effects.items() if k not in of_body(self.twin.effects)}
        given = self.twin.copy()
        return replace(
            model.twin,
            effects=kept | model.twin.effects,
            gel=given.gel,
            arrays=given.arrays,
            history=given.history,
        )

    def parameters(self, model: FittedModel, effect: str) -> dict[str, dict]:
        """Parameters of one effect with interval and unit."""
        units = {p.name: p.unit for p in get_effect(effect).parameters}
        return {
            k: {"value": v.value, "ci95": list(v.ci95) if v.ci95 else None, "unit": units.get(k, "")}
            for k, v in model.twin.effects.get(effect, {}).items()
        }

    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        """Parameters stopped by a bound."""
        return list(model.at_bound)

    def too_little(self, evidence: Evidence) -> str:
        """Why nothing can be told."""
        if not evidence.moves:
            return (
                "This recording cannot tell: the commanded pressure never moves, so nothing about bending "
                "can be learnt from it."
            )
        return (
            f"This recording is too short to tell anything: {evidence.samples} samples to fit and "
            f"{evidence.units} pieces of time to test on."
        )

    def caveats(self, outcome: Outcome) -> list[str]:
        """What the measured pressure tells, and whether there was a test part."""
        out = [self._pressure_note(outcome)]
        if outcome.evidence.at_bound:
            names = ", ".join(outcome.evidence.at_bound)
            out.append(f"At a bound, so the form is not right there: {names}.")
        if not self.parts.has_test:
            out.append(
                "The recording is too short for a part of its own for the report; the errors are optimistic."
            )
        return out

    def _pressure_note(self, outcome: Outcome) -> str:
        if outcome.pressure_error:
            before, after, noise = outcome.pressure_error
            return (
                f"The measured pressure tells air from body: the command misses it by {before:.3g} kPa, the "
                f"modelled air by {after:.3g} kPa, and its noise is {noise:.2g} kPa."
            )
        logged = [c.replace("cmd_", "") for c in self.recording.pressure_columns]
        hidden = "so a slow valve and a creeping body hide each other: a lag may be creep in part."
        if not all(map(self.recording.has, logged)):
            return f"The pressure was not measured, {hidden} Log {', '.join(logged)} to tell them apart."
        if outcome.evidence.moves:
            return (
                f"The measured pressure hardly moves while the command does, so it was left aside, {hidden}"
            )
        moved = max(np.ptp(self.recording.column(c)) for c in logged)
        if moved > max(1e-3, 10 * pneumatics.sensor_noise(self.recording, logged)):
            return (
                "The measured pressure moves although the commanded one never does, so the model had nothing "
                "to follow: check that pressure_cmd_kpa is what was asked for."
            )
        return "The measured pressure does not move either."

    def how_tested(self, outcome: Outcome) -> str:
        """On what the candidates were tried, and why some kind is not among them."""
        none = "No {} was tried: the twin as it is leaves nothing of the {} that would be worth one."
        if not self.measured:
            text = "Without a usable measured pressure, effects of air and body are tried on the pose alike."
            return text if outcome.tested else f"{text} {none.format('effect', 'pose')}"
        text = (
            "As the pressure was measured, effects of the air are tried on it, and all others on the pose, "
            "driven by the measured pressure."
        )
        on_pressure = [t.tested_by == "measured pressure" for t in outcome.tested]
        if not any(on_pressure):
            text += " " + none.format("effect of the air", "measured pressure")
        if all(on_pressure):
            text += " " + none.format("other effect", "pose")
        return text

    def separation(self, rival: Rival) -> Separation | None:
        """The experiment that tells two models apart best."""
        a, b, names = rival.winner.twin, rival.fit.twin, (rival.effect, rival.rival)
        return next(iter(separations(self.recording, a, b, self.noise.value, names)), None)

    def details(self, outcome: Outcome) -> dict:
        """What only a body's `result.json` has."""
        return {"measured_pressure": bool(self.measured)}
