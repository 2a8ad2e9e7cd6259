"""What a study of demonstrations tells beside its numbers: parameters, sentences, experiments."""

from collections.abc import Sequence

from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.study.base import EffectStudy, with_unit
from lerobot_pneutac.study.demonstration_fit import LATE, Fitter, latency_s
from lerobot_pneutac.study.demonstration_strength import COMPLIANCE, STIFFNESS
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_sim.effects.laws import family, is_law, law
from pneutac_sim.effects.registry import body_effects, get_effect
from pneutac_sim.twin import Twin

UNIT = "mm at the tip"
OF_AIR = ("dead_time", "valve_lag", "valve_slew", "leak")
CREEP = "creep"
OF_BODY = (CREEP, "power_law_memory(p)", "hysteresis", "stiffening", "friction")
UNSEEN = ("another friction of the gel", "another stiffness of the finger", "another weight of the object")
LEAST = 5  # demonstrations from which anything can be told
MORE = "Record ten demonstrations or more that press and hold, at two pressures."


def of_air(effect: str) -> bool:
    """Whether arm and gauge tell an effect; of the others touch does."""
    return effect == LATE or (effect != COMPLIANCE and get_effect(effect).of_air)


def bends(effect: str) -> bool:
    """Whether an effect of the twin can be fitted anew to demonstrations: one of air, drive or material."""
    e = law(effect) if is_law(effect) else body_effects()[effect]
    return e.stage in ("pneumatics", "drive", "material") and not e.columns and not e.of_markers


def stopped(name: str) -> bool:
    """Whether a bound stops an effect: the weights of a series may well be zero."""
    return not name.partition(".")[2].startswith(("weight", "delay", "vent_growth", "fill", "band"))


class DemonstrationWords(EffectStudy):
    """The sentences of a `DemonstrationStudy`.

    Attributes:
        fitter: fits models to the episodes that are learnt from.
    """

    unit = UNIT
    more_data = repeat = MORE
    nothing_left = "Nothing needs to be recorded."
    recording: Demonstrations  # pyright: ignore[reportIncompatibleVariableOverride]
    fitter: Fitter

    def twin_of(self, model: FittedModel) -> Twin:
        """The twin as it is to be written."""
        return model.twin

    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on."""
        if effect in self.candidates:
            return ""
        if effect == COMPLIANCE:
            return f"'{COMPLIANCE}' is told by a diagnosis alone; give its folder with --from."
        known = ", ".join(dict.fromkeys((LATE, *OF_AIR, *OF_BODY, *self.own)))
        return f"Demonstrations do not tell of '{effect}'; give one of {known}."

    def parameters(self, model: FittedModel, effect: str) -> dict[str, dict]:
        """The latency of late commands, the stiffness of a compliant finger; of others as ever."""
        if effect == COMPLIANCE:
            known = model.twin.parameters.get(STIFFNESS)
            return {STIFFNESS: with_unit(known, "N m/rad")} if known else {}
        if effect != LATE:
            return super().parameters(model, effect)
        known = model.twin.parameters.get("command_latency_s")
        return {"latency_s": with_unit(known, "s")} if known else {}

    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        """Parameters stopped by a bound."""
        return [n for n in model.at_bound if n.rpartition(".")[0] in effects]

    def describe(self, model: FittedModel, effect: str) -> str:
        """What an effect does, a sentence with the fitted numbers."""
        if effect == LATE:
            late = latency_s(model.twin)
            return f"Your commands act {late:.2g} s late, of arm and air alike."
        if effect == COMPLIANCE:
            share = model.twin.parameter(STIFFNESS) / self.twin.parameter(STIFFNESS)
            return (
                f"Your finger is {'softer' if share < 1 else 'stiffer'} than when the twin was fitted to "
                f"demonstrations: as far as its imprints tell it presses with {share:.2g} times the force."
            )
        if effect in self.own:
            was, now = self.twin.effects[effect], model.twin.effects[effect]
            changes = ", ".join(
                f"{k} {was[k].value:.3g} -> {v.value:.3g}"
                for k, v in now.items()
                if k in was and v.value != was[k].value
            )
            kind = family(effect).replace("_", " ")
            return f"Your finger's {kind} differs from the twin's ({effect}: {changes})."
        return super().describe(model, effect)

    def cause(self, model: FittedModel, effect: str) -> str:
        """What is missing, as a noun phrase with the fitted numbers."""
        if effect == LATE:
            return f"a delay of {latency_s(model.twin):.2g} s of all commands"
        if effect == COMPLIANCE:
            share = model.twin.parameter(STIFFNESS) / self.twin.parameter(STIFFNESS)
            return f"a finger that presses with {share:.2g} times the force"
        if effect in self.own:
            return f"a change of the twin's {family(effect).replace('_', ' ')}"
        return super().cause(model, effect)

    def alike(self, effects: Sequence[str]) -> str:
        """What is told by touch alone may be the contact's instead, of which no model is fitted."""
        body = [e for e in effects if e != COMPLIANCE and not of_air(e)]
        kinds = dict.fromkeys(family(e).replace("_", " ") for e in body)
        told = []
        if kinds:
            told.append(
                f"Touch does not tell {' and '.join(kinds)} apart from {', '.join(UNSEEN[:-1])} or "
                f"{UNSEEN[-1]}; a bench recording of the finger does."
            )
        if COMPLIANCE in effects:
            told.append(
                "A gel that has hardened makes imprints as faint; one that has softened, or more creep than "
                "touch tells of, makes them as strong. A press of known force on the gel tells of the gel."
            )
        return " ".join(told)

    def experiment(self, model: FittedModel, effect: str) -> str:
        """What to record to see an effect apart from its rivals."""
        if effect == LATE:
            return (
                "Command a step of the arm and of the pressure in one frame, and hold still before and after."
            )
        if effect == COMPLIANCE:
            return "Record the finger on the bench with a known weight at its tip, in a column payload_g."
        return super().experiment(model, effect)

    def too_little(self) -> str:
        """Why the demonstrations are too few for any claim."""
        n = len(self.fitter.episodes)
        return "" if n >= LEAST else f"{n} demonstrations are too few to tell what is missing. {MORE}"

    def how_tested(self, outcome: Outcome) -> str:
        """On what the candidates were tried."""
        return "Each candidate is fitted to arm, gauge and touch together and judged on whole episodes."
