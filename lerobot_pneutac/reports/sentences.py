"""What a diagnosis found, in words that a newcomer understands."""

from lerobot_pneutac.diagnosis.experiment import Separation
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.study.base import EffectStudy
from pneutac_sim.effects.registry import get_effect


def lead(study: EffectStudy, outcome: Outcome) -> str:
    """The one sentence (or two) at the top."""
    device, unit, evidence = study.recording.device, study.unit, outcome.evidence
    noise, after = f"{study.noise.value:.3g} {unit}", f"{study.errors(outcome.after)['heldout']:.3g} {unit}"
    if outcome.verdict == "adequate":
        return (
            f"Nothing is missing that this recording could show: the {device}'s error of {after} is the "
            f"noise of the measurement ({noise})."
        )
    if outcome.verdict == "ambiguous":
        if evidence.poor:
            return study.too_little(evidence)
        return (
            f"This recording cannot tell what is missing: {_names(evidence.near_miss)} would help, but the "
            "fall of the error may be chance."
        )
    if outcome.verdict == "unknown_effect":
        tried = (
            f" The best that was found to stand in for it, {_names(outcome.selected)}, removes "
            f"{_removed(study, outcome)} of it."
            if outcome.selected
            else " No effect of the library and no law makes it surely smaller."
        )
        where = study.unknown_where.format(device=device)
        return (
            f"Something that no known effect describes {where}: an error of {after} stays where the noise "
            f"is {noise}.{tried}"
        )
    form = f" Its form is not the whole truth: {after} stay where the noise is {noise}."
    if not outcome.selected:
        return f"What the twin has explains most of the {device}'s error, and no other effect more.{form}"
    first = outcome.selected[0]
    text = (
        f"{study.describe(outcome.after, first)} Adding {_names(outcome.selected)} removes "
        f"{_removed(study, outcome)} of the avoidable error."
    )
    rivals = sorted({r.rival for r in outcome.rivals if r.effect == first})
    if rivals:
        text += f" As far as this recording can tell it may be {' or '.join(rivals)} instead."
    return text + (form if outcome.verdict == "insufficient_form" else "")


def next_experiment(study: EffectStudy, outcome: Outcome) -> tuple[str, Separation | None]:
    """What to record next, and the predictions behind it where two models compete."""
    if outcome.evidence.poor:
        return study.more_data, None
    if outcome.rivals:
        rival = outcome.rivals[0]
        best = study.separation(rival)
        if best:
            return f"To tell {rival.effect} from {rival.rival}: {best.advice}", best
    if outcome.verdict == "unknown_effect":
        return study.repeat, None
    hints = outcome.selected or outcome.evidence.near_miss
    if outcome.verdict in ("ambiguous", "insufficient_form") and hints:
        return f"To see {hints[0]} alone: {get_effect(hints[0]).experiment}", None
    if outcome.verdict == "missing_effect":
        return f"To confirm {hints[0]}: {get_effect(hints[0]).experiment}", None
    return study.nothing_left, None


def _removed(study: EffectStudy, outcome: Outcome) -> str:
    return percent(*study.reduction(outcome.before, outcome.after))


def percent(share: float, interval: tuple[float, float]) -> str:
    """`87 % [81 to 92]`; the interval is left out where it rounds to the number itself."""
    value, lo, hi = (round(100 * x) for x in (share, *interval))
    return f"{value} %" if lo == value == hi else f"{value} % [{lo} to {hi}]"


def _names(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
