"""What a diagnosis found, in words: headline, confidence, warnings, next step, all from one `State`."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from lerobot_pneutac.diagnosis.design import Separation
from lerobot_pneutac.diagnosis.result import SET_UP, Outcome
from lerobot_pneutac.diagnosis.thresholds import AS_IS_NOISE, CLOSE, NOISE
from lerobot_pneutac.diagnosis.verdict import NONE, Explained, Mechanism, called, family_in
from lerobot_pneutac.study.base import EffectStudy
from pneutac_datasets.recording.noise import LEAST_REPEATED
from pneutac_datasets.recording.wording import joined

TWICE = f"Record one program twice, for {LEAST_REPEATED} rows or more, to measure it."
LEAST_SHOWN = 0.05  # probability of a mechanism that is shown
UNTESTED = "cannot be tested, "  # what the reasons of untested effects begin with
AGREED = 0.7  # share of repeated searches below which it is not called confirmed
COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


class Confidence(StrEnum):
    """How far the headline can be trusted."""

    CONFIRMED = "confirmed"
    LIKELY = "likely"
    UNNAMED = "explained but unnamed"
    INCONCLUSIVE = "inconclusive"


MEANING = {
    Confidence.CONFIRMED: "What remains is noise, and every check passed.",
    Confidence.LIKELY: "The improvement is significant. A warning or a probability says what is open.",
    Confidence.UNNAMED: "Something like this is missing. Which equation describes it is open.",
    Confidence.INCONCLUSIVE: "This recording does not decide what is missing.",
}
NOTHING = {
    Confidence.CONFIRMED: "What remains is noise.",
    Confidence.LIKELY: "Nothing lowers the error significantly, but the noise was not measured.",
}


class Kind(StrEnum):
    """What the headline is about."""

    POOR = "too little data"
    NOTHING = "nothing to add"
    CAUSES = "causes found"
    PARTIAL = "most of the error is unexplained, something lowers it"
    UNKNOWN = "the error is unexplained"
    UNDECIDED = "effects that help, but not significantly"
    REST = "an error that remains although the twin explains most"


@dataclass(frozen=True, kw_only=True)
class State:
    """All that the sentences of a diagnosis depend on, computed once."""

    device: str  # `finger`, `arm` or `gel`
    unit: str  # of the errors
    verdict: str  # one of five, see `diagnosis.verdict`
    before: float  # test error of the twin as it is
    after: float  # test error with all causes
    rest: float  # `after` without what single runs have of their own; `after` where they have nothing
    noise: float | None  # of the measurement; None where the recording does not determine it
    noise_how: str = ""  # how it was found, or why it was not
    noise_measured: bool = True  # whether it was declared or measured by repeats
    at_noise: bool = False  # whether what remains is called noise
    noise_too_large: bool = False  # whether the error is significantly below it
    poor: str = ""  # why the recording is too poor for any claim; empty where it is not
    causes: tuple[str, ...] = ()  # what is missing, as noun phrases, the largest first
    set_up: tuple[str, ...] = ()  # those of them that are how the device is made and mounted, no effects
    unnamed: tuple[str, ...] = ()  # those of them whose mechanism is more likely another one
    useless: tuple[tuple[str, float], ...] = ()  # those without which the test error is lower, and that error
    known: int = 0  # how many of them are known causes, such as the finger's weight
    removed: tuple[float, tuple[float, float]] = (0.0, (0.0, 0.0))  # share of the squared error
    rivals: tuple[tuple[str, str], ...] = ()  # pairs of a cause and of an effect that explains as much
    lower: tuple[str, ...] = ()  # effects that alone explain more than the best of the causes
    near_miss: tuple[str, ...] = ()  # effects that help, but not significantly
    agreed: float | None = None  # share of repeated searches that found the first cause; None for no searches
    explained: Explained = Explained.UNDETERMINED  # how much of the error is explained
    interval: tuple[float, float] | None = None  # 95 %, of the error that remains, over the noise
    later: float | None = None  # error over noise of the later part, predicted from the earlier one
    program: float | None = None  # error over noise of programs, each predicted from all others
    unseen: str = ""  # what was not recorded of an effect found, a clause
    where: str = ""  # how commands must be logged for what is explained, a clause
    recorded: str = ""  # the range of conditions for which the answers hold, such as `up to 62 kPa`
    mechanisms: tuple[Mechanism, ...] = ()  # what each may be; empty without calibrated probabilities
    objections: tuple[str, ...] = ()  # checks that failed, one phrase each
    black_box: float = 0.0  # share of the remaining error that a black box predicts; 0 where it is little
    untested: tuple[str, ...] = ()  # what could not be tested, and why
    notes: tuple[str, ...] = ()  # of the recording, one sentence each
    confusable: bool = False  # whether such a recording cannot separate the causes from others
    optimistic: bool = False  # whether there was no test part of its own
    experiment: str = ""  # what to record next

    @property
    def kind(self) -> Kind:
        if self.poor:
            return Kind.POOR
        if not self.causes:
            if self.at_noise or self.verdict == "adequate":
                return Kind.NOTHING
            if self.verdict == "ambiguous":
                return Kind.UNDECIDED
            return Kind.UNKNOWN if self.verdict == "unknown_effect" else Kind.REST
        return Kind.PARTIAL if self.verdict == "unknown_effect" and not self.at_noise else Kind.CAUSES

    @property
    def confidence(self) -> Confidence:
        all_passed = self.at_noise and self.noise_measured and not self.objections
        if self.kind is Kind.NOTHING:
            return Confidence.CONFIRMED if all_passed else Confidence.LIKELY
        if self.kind is not Kind.CAUSES or self.verdict in ("ambiguous", "unknown_effect"):
            return Confidence.INCONCLUSIVE
        agreed = 1.0 if self.agreed is None else self.agreed
        unnamed = bool(self.mechanisms) and not any(m.named for m in self.mechanisms)
        if self.verdict == "insufficient_form" or unnamed:
            return Confidence.UNNAMED
        all_passed = all_passed and not self.rivals and not self.confusable and agreed >= AGREED
        all_passed = all_passed and all(m.certain for m in self.mechanisms[:1])
        return Confidence.CONFIRMED if all_passed else Confidence.LIKELY


def state_of(study: EffectStudy, outcome: Outcome) -> State:
    o, e = outcome, outcome.evidence
    after = study.errors(o.after)["heldout"]
    order = [c.name for c in sorted(o.contributions, key=lambda c: -c.drop[0])]
    named = [n for n in dict.fromkeys([*order, *o.selected, *o.known]) if n in o.selected or n in o.known]
    alone = {t.name: t.heldout for t in o.tested if t.reduction is not None}
    # of causes that were not tried alone, such as a second term of a law, all together count
    best = min((x for n, x in alone.items() if n in o.selected), default=after)
    lower = [n for n, x in alone.items() if n not in o.selected and o.selected and x < best]
    confusable = study.confusable_with(o.selected)
    return State(
        device=study.recording.device,
        unit=study.unit,
        verdict=o.verdict,
        poor=study.too_little() if e.poor else "",
        causes=_causes(study, o, named),
        set_up=_causes(study, o, [n for n in named if n in SET_UP]),
        unnamed=_causes(study, o, [n for n in o.selected if n not in o.named]),
        useless=tuple(
            (study.cause(o.after, c.name), c.error_without) for c in o.contributions if c.drop[0] <= 0
        ),
        known=len(o.known),
        before=study.errors(o.before)["heldout"],
        after=after,
        rest=(o.run_terms or {}).get("error", after),
        noise=study.noise.value,
        noise_how=study.noise.how,
        noise_measured=e.noise_known and study.noise.value is not None,
        at_noise=e.is_noise and study.noise.value is not None,
        noise_too_large=e.noise_too_large,
        removed=study.reduction(o.before, o.after) if named else (0.0, (0.0, 0.0)),
        rivals=tuple((called(r.effect, r.winner.twin), called(r.rival, r.fit.twin)) for r in o.rivals),
        lower=tuple(map(called, lower)),
        near_miss=tuple(map(called, e.near_miss)),
        agreed=o.chosen_in.get(o.selected[0]) if o.selected else None,
        explained=o.explained,
        interval=e.interval,
        later=e.later,
        program=e.program,
        unseen=e.unseen,
        where=e.where,
        recorded=study.recorded,
        mechanisms=tuple(o.mechanisms) if named else (),
        objections=tuple(e.objections) if named else (),
        black_box=e.left_to_black_box if e.unfinished else 0.0,
        untested=tuple(f"{called(u.name)} ({u.reason.removeprefix(UNTESTED)})" for u in study.untested),
        notes=tuple(dict.fromkeys(n for n in (*study.findings, confusable, *study.caveats(o)) if n)),
        confusable=bool(confusable),
        optimistic=not study.parts.has_test,
        experiment=next_experiment(study, o)[0],
    )


def _causes(study: EffectStudy, outcome: Outcome, named: list[str]) -> tuple[str, ...]:
    kinds = {n: family_in(outcome.twin, n) for n in named}
    count = Counter(kinds.values())
    phrases = (
        study.cause(outcome.after, n) if count[k] == 1 else f"{called(k)} ({count[k]} terms)"
        for n, k in kinds.items()
    )
    return tuple(dict.fromkeys(phrases))


def headline(s: State) -> str:
    """The causes by size, the error, and the two answers."""
    return " ".join(part for part in (_headline(s), explanation(s), mechanism(s)) if part)


def explanation(s: State) -> str:
    """How much of the error is explained, a sentence; empty where the recording is too poor for any claim."""
    if s.poor:
        return ""
    if s.noise is None:
        return "Explained: undetermined, since the noise is not known."
    times = f"{s.rest / s.noise:.2f} times the {'' if s.noise_measured else 'estimated '}noise"
    if s.interval is not None:
        times += f", 95 % interval {s.interval[0]:.2f} to {s.interval[1]:.2f}"
    match s.explained:
        case Explained.FULLY:
            recorded = f", as far as was recorded ({s.recorded})" if s.recorded else ""
            counts = f"up to {NOISE:g} times counts as noise"
            if s.rest > NOISE * s.noise:
                each = [s.rest / s.noise, *(x for x in (s.later, s.program) if x is not None)]
                mean = (sum(x * x for x in each) / len(each)) ** 0.5
                counts = f"with later rows and other programs {mean:.2f} times, and {counts}"
            where = f"{recorded}{', ' * bool(s.where)}{s.where}"
            return f"Explained: fully{where}. The error is {times}; {counts}."
        case Explained.MOSTLY if s.at_noise and s.unseen:
            return f"Explained: mostly. The error is {times}, but {s.unseen}."
        case Explained.MOSTLY if s.at_noise:
            where = {
                "the last part, predicted from the first": s.later,
                "programs that are predicted from all others": s.program,
            }
            worst = max(where, key=lambda k: where[k] or 0.0)
            but = f"{where[worst] or 0.0:.2f} times the noise in {worst}"
            return f"Explained: mostly. The error is {times}, but {but}."
        case Explained.UNDETERMINED if s.noise_too_large:
            return f"Explained: undetermined, since the noise is estimated too large: the error is {times}."
        case Explained.UNDETERMINED if s.at_noise:
            more = f"above {CLOSE:g} times it would be more than noise"
            return f"Explained: undetermined, since the error is known too roughly: {times}, and {more}."
        case Explained.UNDETERMINED if not s.noise_measured:
            return f"Explained: undetermined, since the error is {times}."
        case _:
            return f"Explained: {s.explained}. The error is {times}."


def mechanism(s: State) -> str:
    """Which mechanism the causes are, a sentence; empty where there is none, or only how it is mounted."""
    if s.poor or s.kind not in (Kind.CAUSES, Kind.PARTIAL) or len(s.causes) == len(s.set_up):
        return ""
    if not s.mechanisms:
        why = "none is calibrated for such recordings" if s.noise_measured else "the noise was not measured"
        return f"Mechanism: no probability is given, since {why}."
    out = []
    for m in s.mechanisms:
        shown = [(k, p) for k, p in m.ranked if p >= LEAST_SHOWN or k == m.cause]
        listed = ", ".join(f"{k if k == NONE else called(k)} {100 * p:.0f} %" for k, p in shown)
        certain = f"{called(m.cause)} is certain ({100 * m.probability:.0f} %)"
        out.append(certain if m.certain else f"what looks like {called(m.cause)} is {listed}")
    return f"Mechanism: {'; '.join(out)}."


def _headline(s: State) -> str:
    error = f"{s.rest:.3g} {s.unit}"
    noise = f"noise {s.noise:.3g} {s.unit}" if s.noise is not None else "noise unknown"
    match s.kind:
        case Kind.POOR:
            return s.poor
        case Kind.NOTHING if s.at_noise:
            where = "below" if s.noise_too_large else "at"
            at = f"{where} the {'' if s.noise_measured else 'estimated '}noise ({s.noise:.3g} {s.unit})"
            return f"Nothing is missing that this recording can show: the test error of {error} is {at}."
        case Kind.NOTHING:
            none = f"Nothing that was tested explains the test error of {error}"
            tried = "neither a known effect nor a black box of the command"
            return f"{none}, {tried}. How much of it is noise is not known."
        case Kind.UNDECIDED:
            why = f", but the noise {s.noise_how}"
            but = why if s.noise is None else f" ({noise}), but not significantly"
            lower = f"{joined(s.near_miss)} would lower the test error of {error}{but}"
            return f"This recording cannot decide what is missing: {lower}."
        case Kind.UNKNOWN:
            left = f"a test error of {error} remains ({noise})"
            lacks = "The model is missing something that no known effect describes"
            return f"{lacks}: {left}, and nothing that was tried lowers it significantly."
        case Kind.REST:
            most = f"The twin explains most of the {s.device}'s error, and no further effect lowers it"
            return f"{most} significantly: a test error of {error} remains ({noise})."
        case Kind.PARTIAL:
            best = f"The best model found adds {joined(s.causes)} and removes {_removed(s)}"
            return f"Most of the error is unexplained: {error} remain ({noise}). {best}."
    runs = "" if s.rest == s.after else f", and to {error} without each run's own offset"
    falls = f"the test error falls from {s.before:.3g} to {s.after:.3g} {s.unit}{runs} ({noise})."
    causes = [c for c in s.causes if c not in s.set_up and c not in s.unnamed]
    besides = [*s.unnamed, *s.set_up]
    if s.unnamed:
        falls += f" Not named a cause, since another mechanism or none is likelier: {joined(s.unnamed)}."
    if not causes and s.unnamed:
        verb = "may be" if s.confidence is Confidence.INCONCLUSIVE else "is"
        return f"Something {verb} missing from the model and cannot be named. With {joined(besides)} {falls}"
    if not causes:
        return f"The model lacks no effect that this recording shows. With {joined(besides)} fitted {falls}"
    n = len(causes)
    verb = "may be" if s.confidence is Confidence.INCONCLUSIVE else "is" if n == 1 else "are"
    count = COUNTS[n] if n < len(COUNTS) else f"{n}"
    each = causes[0] if n == 1 else "; ".join(f"({i}) {c}" for i, c in enumerate(causes, 1))
    things = f"{count.capitalize()} {'thing' if n == 1 else 'things'}"
    these = "it" if n == 1 else "both" if n == 2 else f"all {count}"
    these += f" and {joined(besides)}" if besides else ""
    # The equation is what was found; that it is the cause as well is said where the probability allows it.
    firm = bool(s.mechanisms) and all(m.certain for m in s.mechanisms if m.named)
    like = ":" if firm else f" and {'behaves' if n == 1 else 'behave'} like"
    return f"{things} {verb} missing from the model{like} {each}. With {these} {falls}"


def meaning(s: State) -> str:
    return (NOTHING if s.kind is Kind.NOTHING else MEANING)[s.confidence]


def warnings(s: State) -> list[str]:
    """What speaks against the headline, what it leaves open and what the recording lacks."""
    out = []
    if not s.poor:
        out += [f"A check failed: {o}{_size(s) if 'black box' in o else ''}." for o in s.objections]
        if s.kind is Kind.CAUSES and not s.at_noise and s.noise and not s.objections:
            out.append(f"The error that remains is {s.rest / s.noise:.2g} times the noise.")
        out += _as_well(s)
        for cause, without in s.useless:
            out.append(f"Without {cause} the test error is no higher: {without:.3g} {s.unit}.")
        if s.black_box and not any("black box" in o for o in s.objections):
            share = f"{100 * s.black_box:.0f} %"
            out.append(f"A black box predicts {share} of the remaining error from the inputs{_size(s)}.")
        if s.agreed is not None and s.agreed < AGREED:
            out.append(f"{100 * s.agreed:.0f} % of repeated searches found the first-listed cause.")
        if s.kind is Kind.NOTHING and s.at_noise and s.noise is not None:
            least = s.noise * (AS_IS_NOISE**2 - 1) ** 0.5
            out.append(f"An effect that adds less than {least:.2g} {s.unit} to the error would not show.")
        if s.explained is Explained.FULLY and s.recorded:
            changes = "what changes between recordings, such as the mount or the marker's place"
            out.append(f"One recording cannot show {changes}.")
        if s.noise is None:
            out.append(f"The noise {s.noise_how}.")
        elif not s.noise_measured:
            out.append(f"The noise is an estimate: {s.noise_how}. {TWICE}")
        if s.optimistic:
            out.append("The recording is too short for a test part of its own; the errors are optimistic.")
    out += s.notes
    if s.untested:
        out.append(f"Not tested: {'; '.join(s.untested)}.")
    return out


def _size(s: State) -> str:
    """From which error to which a black box gets, a clause; empty where the noise is not known."""
    if not s.noise or not s.black_box or s.after <= s.noise:
        return ""
    least = (s.noise**2 + (1 - s.black_box) * (s.after**2 - s.noise**2)) ** 0.5
    return f", from {s.after:.3g} to {least:.3g} {s.unit} (noise {s.noise:.3g})"


def _as_well(s: State) -> list[str]:
    return [f"The data fit {b} about as well as {a}." for a, b in s.rivals]


def do_next(s: State, command: str) -> str:
    """One command or one experiment; `command` adds the causes to the twin."""
    if s.kind is Kind.CAUSES and s.confidence is not Confidence.INCONCLUSIVE:
        return command
    if s.kind is Kind.NOTHING and s.noise is not None:
        return "Record another day and compare the twin with it."
    return s.experiment


def alternatives(s: State) -> str:
    """Whether another effect would do as well, a sentence; empty where nothing was found."""
    if not s.causes or s.poor:
        return ""
    if s.rivals:
        return " ".join(_as_well(s))
    if s.lower:
        lower = f"By itself {joined(s.lower)} reaches a slightly lower test error than the causes found"
        return f"{lower}. The choice was made by cross-validation on other blocks."
    return "No other effect that was tried alone has a test error as low."


def evidence(s: State) -> str:
    if not s.causes or s.poor:
        return ""
    out = [f"The causes remove {_removed(s)}, on test blocks."]
    if s.agreed is not None:
        share = f"{100 * s.agreed:.0f} %"
        out.append(f"Repeated on other splits of the data, {share} of the searches found the first cause.")
    return " ".join(out)


def _removed(s: State) -> str:
    return f"{percent(*s.removed)} of the squared error{'' if s.noise is None else ' above the noise'}"


def hedged(description: str, kind: str, mechanisms: Sequence[Mechanism]) -> str:
    """What an effect does, with the probability of its family where that is not certain."""
    for m in mechanisms:
        if m.cause == kind and not m.certain:
            return (
                f"{called(kind)} is not certain ({100 * m.probability:.0f} %). As an equation: {description}"
            )
    return description


def next_experiment(study: EffectStudy, outcome: Outcome) -> tuple[str, Separation | None]:
    """What to record next, and the predictions behind it where two models compete."""
    if outcome.evidence.poor:
        return study.more_data, None
    if outcome.not_yet:
        return outcome.not_yet, None
    if not outcome.evidence.is_noise and (log := study.to_log(outcome)):
        return log, None
    if outcome.rivals:
        rival = outcome.rivals[0]
        best = study.separation(rival)
        if best:
            pair = called(rival.effect, rival.winner.twin), called(rival.rival, rival.fit.twin)
            apart = best.apart(study.unit, study.noise.value)
            return f"To separate {pair[0]} from {pair[1]}: {best.advice} {apart}", best
    if outcome.verdict == "unknown_effect" and not outcome.evidence.is_noise:
        return study.repeat, None
    hints = outcome.selected or outcome.evidence.near_miss
    if outcome.verdict == "adequate" or not hints:
        return study.nothing_left, None
    hint = called(hints[0], outcome.twin)
    return f"To confirm {hint}: {study.experiment(outcome.after, hints[0])}", None


def percent(share: float, interval: tuple[float, float]) -> str:
    """`87 % [81 to 92]`; the interval is left out where it rounds to the number itself."""
    value, lo, hi = (round(100 * x) for x in (share, *interval))
    return f"{value} %" if lo == value == hi else f"{value} % [{lo} to {hi}]"
