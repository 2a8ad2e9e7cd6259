"""What a study of a finger or an arm tells beside its numbers: parameters, sizes, caveats, experiments."""

from collections.abc import Sequence

import numpy as np

from lerobot_pneutac.diagnosis.experiment import Separation, predict, separations
from lerobot_pneutac.diagnosis.law_programs import law_program
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.result import PROFILE, Outcome, Rival
from lerobot_pneutac.diagnosis.verdict import too_few
from lerobot_pneutac.study import gauge
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.pair import LONGER
from lerobot_pneutac.study.reading import read
from pneutac_datasets.recording.pressures import supply_limits
from pneutac_datasets.recording.wording import listed
from pneutac_sim.effects.laws import family
from pneutac_sim.effects.registry import get_effect

LATE = ("creep", "valve_lag", "ringing", "leak")  # families that air and body may both cause
REPEAT = "Repeat one test after an hour. Differences between the two come from the setup, not the device."
STILL = 0.02  # of the noise: an effect that moves the prediction by less ended where it does nothing


class BodyWords(EffectStudy):
    """The sentences of a `BodyStudy`.

    Attributes:
        measured: columns of measured pressure, empty where it tells nothing.
        breaks: corrections of the recording for this judgement, see `BodyStudy.apply_break`.
    """

    measured: list[str]
    breaks: tuple[dict, ...]
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

    def cause(self, model: FittedModel, effect: str) -> str:
        """What is missing, as a noun phrase with the fitted numbers."""
        return "a bend that is uneven along its length" if effect == PROFILE else super().cause(model, effect)

    def alike(self, effects: Sequence[str]) -> str:
        """The finding that lags of air and of body look alike, where such a lag was found."""
        late = [e for e in effects if family(e) in LATE or get_effect(e).stage == "pneumatics"]
        missing = (f for f in self.findings if "no measured pressure" in f)
        return next(missing, "") if late else ""

    def size(self, model: FittedModel, effect: str) -> str:
        """What the effect does to the prediction that another gain and offset could not."""
        data = read(self.recording, model.twin)
        seen, plain = (predict(t, data)[0] for t in (model.twin, model.twin.without(effect)))
        ground = np.concatenate([plain, np.ones((len(plain), 1))], axis=1)
        left = seen - ground @ np.linalg.lstsq(ground, seen, rcond=None)[0]
        what = {"mm": "tip", "rad": "bend", "1/m": "curvature"}[self.unit]
        moved = np.linalg.norm(left, axis=1)
        if moved.max() < 1e-6:  # such as a turned base, which an offset does as well
            return ""
        typically = f"{np.sqrt((moved**2).mean()):.2g} {self.unit}"
        return f"That moves its {what} by {typically} typically and {moved.max():.2g} {self.unit} at most."

    def idle(self, model: FittedModel, effect: str) -> bool:
        """Whether an effect moves the prediction by less than `STILL` of the noise."""
        if effect not in model.twin.effects:
            return False
        data = read(self.recording, model.twin)
        seen, plain = (predict(t, data)[0] for t in (model.twin, model.twin.without(effect)))
        return bool(np.sqrt(((seen - plain) ** 2).sum(axis=1).mean()) < STILL * (self.noise.value or 0.0))

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
        """What the pressure log leaves open, where there is one."""
        logged = [c.replace("cmd_", "") for c in self.recording.pressure_columns]
        if self.measured or not all(map(self.recording.has, logged)):
            return []
        if self._moves:
            return [
                "The measured pressure hardly moves while the command does and was left out, so a slow valve "
                "and a creeping body look alike."
            ]
        moved = max(np.ptp(self.recording.column(c)) for c in logged)
        if moved > max(1e-3, 10 * gauge.sensor_noise(self.recording, logged)):
            return [
                "The measured pressure moves although the commanded one never does: check that "
                "pressure_cmd_kpa is what was asked for."
            ]
        return ["The measured pressure does not move either."]

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
        return {
            "measured_pressure": bool(self.measured),
            "base_model": outcome.base_model,
            "data_breaks": list(self.breaks),
        }
