"""What a study of a finger or an arm tells beside its numbers: parameters, sizes, caveats, experiments."""

from collections.abc import Sequence

import numpy as np

from lerobot_pneutac.diagnosis.experiment import Separation, predict, separations
from lerobot_pneutac.diagnosis.law_programs import law_program
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.result import Outcome, Rival
from lerobot_pneutac.diagnosis.verdict import too_few
from lerobot_pneutac.study import gauge
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.pair import LONGER
from lerobot_pneutac.study.reading import read
from pneutac_datasets.recording.pressures import supply_limits
from pneutac_datasets.recording.wording import listed

REPEAT = "Run the same program twice, an hour apart: what comes back is the device, what does not is the lab."


class BodyWords(EffectStudy):
    """The sentences of a `BodyStudy`.

    Attributes:
        measured: columns of measured pressure, empty where it tells nothing.
    """

    measured: list[str]
    unknown_where = "moves your {device}"
    more_data, repeat = LONGER, REPEAT

    @property
    def nothing_left(self) -> str:
        """The range is all that could grow, unless the supply ends there."""
        more = self._supply or "; go to higher pressure to find where the twin ends"
        return f"Nothing needs to be recorded{more}."

    @property
    def _supply(self) -> str:
        """Where the supply ends, as the end of a sentence; empty where nothing shows it."""
        ends = supply_limits(self.recording).values()
        return f": the supply ends at {listed(f'{kpa:.3g}' for kpa in ends)} kPa" if ends else ""

    def size(self, model: FittedModel, effect: str) -> str:
        """What the effect does to the prediction that another gain and offset could not."""
        data = read(self.recording, model.twin)
        seen, plain = (predict(t, data)[0] for t in (model.twin, model.twin.without(effect)))
        ground = np.concatenate([plain, np.ones((len(plain), 1))], axis=1)
        left = seen - ground @ np.linalg.lstsq(ground, seen, rcond=None)[0]
        what = {"mm": "tip", "rad": "bend", "1/m": "curvature"}[self.unit]
        moved = np.linalg.norm(left, axis=1)
        typically = f"{np.sqrt((moved**2).mean()):.2g} {self.unit}"
        return f"That moves its {what} by {typically} typically and {moved.max():.2g} {self.unit} at most."

    def experiment(self, model: FittedModel, effect: str) -> str:
        """By the law's own program where it is one and was found."""
        constants = {k: v.value for k, v in model.twin.effects.get(effect, {}).items()}
        program = law_program(self.recording, effect, constants) if constants else None
        advice = program.advice if program else super().experiment(model, effect)
        return f"{advice} Go no higher{self._supply}." if self._supply else advice

    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        """Parameters stopped by a bound."""
        return list(model.at_bound)

    @property
    def _moves(self) -> bool:
        """Whether the commanded pressure moves at all."""
        command = self.recording.samples[self.recording.pressure_columns].to_numpy(float)
        return bool(np.ptp(command, axis=0).max() > 1e-3)

    def too_little(self) -> str:
        """Why nothing can be told."""
        if not self._moves:
            return (
                "This recording cannot tell: the commanded pressure never moves, so nothing about bending "
                "can be learnt from it."
            )
        samples, units = int((~self.test.mask).sum()), self.test.units
        if not too_few(samples, units):
            return ""
        return (
            f"This recording is too short to tell anything: {samples} samples to fit and "
            f"{units} pieces of time to test on."
        )

    def caveats(self, outcome: Outcome) -> list[str]:
        """What is not explained, what the pressure tells, and whether there was a test part."""
        e, out = outcome.evidence, []
        if outcome.selected and e.objections:
            out.append(f"Not the whole truth: {'; '.join(e.objections)}.")
        if e.unfinished:
            out.append(
                f"Unfinished: {100 * e.left_to_black_box:.0f} % of what is left still follows the inputs, as "
                "a black box shows; a form is missing that neither library nor laws have."
            )
        if self.noise.value is None:
            out.append(f"The noise {self.noise.how}.")
        elif not e.noise_known:
            out.append("The noise is an estimate: it was neither declared nor measured by repeated programs.")
        if not self.measured:
            out.append(self._pressure_note())
        if not self.parts.has_test:
            out.append(
                "The recording is too short for a part of its own for the report; the errors are optimistic."
            )
        return out

    def _pressure_note(self) -> str:
        logged = [c.replace("cmd_", "") for c in self.recording.pressure_columns]
        if not all(map(self.recording.has, logged)):
            return (
                "The pressure was not measured, so a slow valve and a creeping body hide each other: a lag "
                f"may be creep in part. Log {', '.join(logged)} to tell them apart."
            )
        if self._moves:
            return (
                "The measured pressure hardly moves while the command does and was left aside; a slow valve "
                "and a creeping body hide each other: a lag may be creep in part."
            )
        moved = max(np.ptp(self.recording.column(c)) for c in logged)
        if moved > max(1e-3, 10 * gauge.sensor_noise(self.recording, logged)):
            return (
                "The measured pressure moves although the commanded one never does, so the model had nothing "
                "to follow: check that pressure_cmd_kpa is what was asked for."
            )
        return "The measured pressure does not move either."

    def how_tested(self, outcome: Outcome) -> str:
        """On what the candidates were tried."""
        if not self.measured:
            return "Effects of air and body are tried on the pose alike; no measured pressure is of use."
        return (
            "Effects of the air are tried on the measured pressure and on the pose, all others on the pose."
        )

    def separation(self, rival: Rival) -> Separation | None:
        """The experiment that tells two models apart best."""
        a, b, names = rival.winner.twin, rival.fit.twin, (rival.effect, rival.rival)
        return next(iter(separations(self.recording, a, b, self.noise.floor, names)), None)

    def details(self, outcome: Outcome) -> dict:
        """What only a body's `result.json` has."""
        return {"measured_pressure": bool(self.measured), "base_model": outcome.base_model}
