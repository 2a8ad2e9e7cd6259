"""What a diagnosis found, in words that a newcomer understands."""

from lerobot_pneutac.diagnosis.experiment import Separation
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.study.base import EffectStudy
from pneutac_datasets.recording.wording import plural
from pneutac_sim.effects.laws import family, is_law


def lead(study: EffectStudy, outcome: Outcome) -> str:
    """The one sentence (or two) at the top, and what the recording does not tell apart from what is named."""
    return f"{_lead(study, outcome)} {study.alike(outcome.selected)}".rstrip()


def _lead(study: EffectStudy, outcome: Outcome) -> str:
    device, unit, evidence = study.recording.device, study.unit, outcome.evidence
    after = f"{study.errors(outcome.after)['heldout']:.3g} {unit}"
    noise = "unknown" if study.noise.value is None else f"{study.noise.value:.3g} {unit}"
    if outcome.verdict == "adequate" and not evidence.is_noise:
        return (
            f"Nothing is missing that this recording could show: what is left of the {device}'s error, "
            f"{after}, follows nothing that was commanded; how much of it is noise is not known."
        )
    if outcome.verdict == "adequate":
        return (
            f"Nothing is missing that this recording could show: the {device}'s error of {after} is the "
            f"noise of the measurement ({noise})."
        )
    if outcome.verdict == "ambiguous":
        if evidence.poor:
            return study.too_little()
        why = (
            "the fall of the error may be chance"
            if study.noise.value is not None
            else f"the noise {study.noise.how}"
        )
        return (
            f"This recording cannot tell what is missing: {_names(evidence.near_miss)} would help, but {why}."
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
    before = f"{study.errors(outcome.before)['heldout']:.3g} {unit}"
    others = list(dict.fromkeys(_kind(e) for e in outcome.selected[1:] if _kind(e) != _kind(first)))
    text = (
        f"{plainly(study, outcome, first)}{f' It also shows {_listed(others)}.' if others else ''} With this "
        f"the error where nothing was fitted falls from {before} to {after}; the noise of the measurement "
        f"{'is' if study.noise.value is None else 'makes'} {noise}."
    )
    rivals = sorted({r.rival for r in outcome.rivals if r.effect == first})
    if rivals:
        text += f" As far as this recording can tell it may be {' or '.join(map(called, rivals))} instead."
    return text + (" Its form is not the whole truth." if outcome.verdict == "insufficient_form" else "")


def plainly(study: EffectStudy, outcome: Outcome, effect: str) -> str:
    """What an effect does and how much, without its equation."""
    text = study.describe(outcome.after, effect)
    if is_law(effect):
        text = text.partition(": ")[0].rstrip(".") + "."
    size = study.size(outcome.after, effect)
    return f"{text} {size}" if size else text


def how_sure(study: EffectStudy, outcome: Outcome) -> str:
    """How far what was found can be trusted."""
    o, e = outcome, outcome.evidence
    if e.poor:
        return "Not at all: the recording is too poor for any claim."
    if not o.selected:
        tried = f"{plural(len(o.tested), 'effect')} came closest" if o.tested else "no effect came close"
        return f"Nothing that was tried surely lowers the error; {tried}."
    if e.is_noise:
        explained = "Very: it explains all that is more than noise"
    elif e.noise_known and e.after is not None:
        explained = f"Fairly: what is left is {e.after:.3g} times the noise"
    else:
        explained = "Fairly: what is left follows nothing that was commanded, but the noise is not known"
    sure = {
        "missing_effect": explained,
        "insufficient_form": "That something of this kind is there, yes; of its form, no",
        "unknown_effect": "Not at all: it only stands in for what is there",
    }.get(o.verdict, "Hardly: it may be chance")
    votes = (
        f"; {100 * o.chosen_in[o.selected[0]]:.0f} % of repeated searches on other parts of the data chose it"
    )
    return (
        f"{sure}. It removes {_removed(study, o)} of the squared error above the noise, on stretches of time "
        f"that no fit saw{votes if o.selected[0] in o.chosen_in else ''}.{_belief(o)}"
    )


def _belief(outcome: Outcome) -> str:
    if outcome.likely_right is None:
        return ""
    share = 100 * outcome.likely_right
    return f" Of foreign devices with a finding like this {share:.0f} % had the physics that was named first."


def not_explained(study: EffectStudy, outcome: Outcome) -> str:
    """What stays, and what could not be looked for."""
    unit = study.unit
    after, noise = study.errors(outcome.after)["heldout"], study.noise.value
    if outcome.evidence.is_noise:
        text = f"Nothing that this recording could show: the error of {after:.3g} {unit} is the noise."
    elif noise is None:
        text = f"The error is {after:.3g} {unit}; how much of it is noise {study.noise.how}."
    else:
        left = max(after**2 - noise**2, 0.0) ** 0.5
        text = f"{left:.2g} {unit} beside the noise (the error is {after / noise:.3g} times the noise)."
    if study.untested:
        text += f" Not looked for, as it was not recorded: {_names([u.name for u in study.untested])}."
    return text


def called(name: str) -> str:
    """An effect by its name, a law by its family and its name."""
    return f"{_kind(name)} as {name}" if is_law(name) else _kind(name)


def _kind(name: str) -> str:
    return family(name).replace("_", " ")


def next_experiment(study: EffectStudy, outcome: Outcome) -> tuple[str, Separation | None]:
    """What to record next, and the predictions behind it where two models compete."""
    if outcome.evidence.poor:
        return study.more_data, None
    if outcome.rivals:
        rival = outcome.rivals[0]
        best = study.separation(rival)
        if best:
            return f"To tell {called(rival.effect)} from {called(rival.rival)}: {best.advice}", best
    if outcome.verdict == "unknown_effect":
        return study.repeat, None
    hints = outcome.selected or outcome.evidence.near_miss
    aim = {"ambiguous": "see", "insufficient_form": "see", "missing_effect": "confirm"}.get(outcome.verdict)
    if aim is None or not hints:
        return study.nothing_left, None
    return f"To {aim} {called(hints[0])}: {study.experiment(outcome.after, hints[0])}", None


def _removed(study: EffectStudy, outcome: Outcome) -> str:
    return percent(*study.reduction(outcome.before, outcome.after))


def percent(share: float, interval: tuple[float, float]) -> str:
    """`87 % [81 to 92]`; the interval is left out where it rounds to the number itself."""
    value, lo, hi = (round(100 * x) for x in (share, *interval))
    return f"{value} %" if lo == value == hi else f"{value} % [{lo} to {hi}]"


def _names(names: list[str]) -> str:
    return _listed([called(n) for n in names])


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
