"""Switches effects on in a twin, re-fits everything, and reports what each term is worth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from lerobot_pneutac.cli.options import PairOptions, keywords
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import PairedTest
from lerobot_pneutac.diagnosis.result import Contribution, FittedModel, Refits
from lerobot_pneutac.diagnosis.search import Steps
from lerobot_pneutac.diagnosis.verdict import Mechanism, called, family_in
from lerobot_pneutac.reports.page import AFTER, BEFORE, KNOWN, Report, parameter_rows, span
from lerobot_pneutac.reports.sentences import hedged, percent
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.pair import load_pair, same_body
from lerobot_pneutac.verbs.diagnose import Diagnosis, read_found
from lerobot_pneutac.verbs.result import ANOTHER_DAY, Result, command_on
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import joined
from pneutac_sim.effects.laws import is_law
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.executor import one_thread
from pneutac_sim.files import check_writable
from pneutac_sim.twin import Twin


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Addition(Result):
    """What switching effects on did."""

    effect: str  # their names
    accepted: bool  # whether the test error falls significantly by them, and by nothing else
    reason: str  # why they were refused, a sentence; empty where they were accepted
    # with the effects, re-fitted and not yet written; the one that was given where they were refused
    twin: Twin
    recording: str  # that was used
    seed: int  # that decided what was held out
    unit: str = ""  # of the errors
    # error that the measurement's own noise makes; None where the recording does not show it
    noise_floor: float | None = 0.0
    # error of the twin as it is, re-fitted: `train`, `heldout` (the test part), `heldout_ci95`; None where
    # nothing was fitted
    before: dict | None = None
    # the same with the known causes that the recording shows; `before` where there are none
    baseline: dict | None = None
    after: dict | None = None  # the same with the effects too
    known: tuple[str, ...] = ()  # known causes that are switched on with them, such as `payload`
    contributions: tuple[Contribution, ...] = ()  # what each term adds to all others, the largest first
    reduction: float = 0.0  # share of the avoidable error that known causes and effects remove together
    reduction_ci95: tuple[float, float] = (0.0, 0.0)  # its interval
    parameters: dict[str, dict] | None = None  # name to `value`, `ci95` and `unit`
    at_bound: tuple[str, ...] = ()  # parameters stopped by a bound
    not_identified: dict[str, str] | None = None  # parameters that the recording does not identify, and why
    physics: tuple[str, ...] = ()  # what each effect does to this device, sentences with the fitted numbers
    findings: tuple[str, ...] = ()  # of the data check, one sentence each
    # of the diagnosis that found it, one phrase each; empty where an effect was named
    objections: tuple[str, ...] = ()
    diagnosed: bool = False  # whether a diagnosis found them; its own output has the notes and the table
    unconfirmed: bool = False  # whether the twin is stored although the effects were refused
    instead: str = ""  # another effect that explains more; empty where there is none
    instead_error: float | None = None  # test error with it in place of these effects
    noted: dict | None = field(default=None, repr=False)  # what the twin's history stores besides the errors
    saved_to: Path | None = None  # the twin's folder once it was saved

    keys = (
        "effect", "accepted", "reason", "unconfirmed", "unit", "noise_floor", "before", "baseline", "after",
        ("known_causes", "known"), "contributions", "reduction", "reduction_ci95", "parameters", "at_bound",
        "not_identified", ("checks", "findings"), "objections",
    )  # fmt: skip

    def save(self, folder: str | Path, report: Callable[[Result], object] = lambda _: None) -> "Addition":
        """Writes the twin as the next version of `folder`; returns the result that knows where it lies.

        `report` is called with that result before the version counts; where it raises, none is made.
        """
        twin = self.twin.copy()
        saved = replace(self, twin=twin, saved_to=Path(folder))
        after = self.after or {}
        errors = {k: after[k] for k in ("train", "heldout", "arm_and_gauge", "touch") if k in after}
        if "touch" in after:  # of demonstrations, which others of the same finger are compared with
            errors["heldout_ci95"] = list(after["heldout_ci95"])
        errors |= {"unit": self.unit, "seed": self.seed} | (self.noted or {})
        change = f"added {self.effect}" + (" (unconfirmed)" if self.unconfirmed else "")
        twin.save_version(folder, change, self.recording, errors, lambda: report(saved))
        return saved

    @property
    def _effects(self) -> list[str]:
        return [e for e in self.effect.split(", ") if e not in self.known]

    @property
    def title(self) -> str:
        stored = "Added" if self.accepted else "Added without confirmation:" if self.unconfirmed else ""
        names = _plain(self.effect.split(", "))
        return f"{stored} {names}" if stored else f"Not added: {names}"

    @property
    def sentence(self) -> str:
        before, base, after = self.before, self.baseline, self.after
        if not self.accepted or before is None or base is None or after is None:
            return self.reason
        noise = "" if self.noise_floor is None else f" (noise {self.noise_floor:.3g} {self.unit})"
        text, causes, s = "", self.known, "s" * (len(self.known) == 1)
        was, now, end = (f"{e['heldout']:.3g}" for e in (before, base, after))
        if causes:
            verb = "lower" if base["heldout"] < before["heldout"] else "raise"
            change = f"{verb}{s} the test error from {was} to {now}"
            change = f"leave{s} the test error at {now}" if was == now else change
            text = f"Known causes: {_plain(causes)} {change} {self.unit}{'' if self._effects else noise}. "
        if self._effects:
            it = "it" if causes else "the test error"
            text += f"With {_plain(self._effects)} {it} falls from {now} to {end} {self.unit}{noise}."
        return text.strip()

    @property
    def findings_shown(self) -> tuple[str, ...]:
        return () if self.diagnosed else self.findings

    def rows(self) -> list[dict]:
        return [] if self.diagnosed else self._errors()

    def _errors(self) -> list[dict]:
        noise = "unknown" if self.noise_floor is None else f"{self.noise_floor:.3g}"
        rows = []
        for name, e, _ in self._steps():
            row = {f"error, {self.unit} (noise {noise})": name, "training": e["train"]}
            row |= {"test": e["heldout"], "95 % interval": span(e["heldout_ci95"])}
            rows.append(row | ({"contact": e["heldout_contact"]} if "heldout_contact" in e else {}))
        return rows

    @property
    def next_command(self) -> str:
        """To test it on another day; where the effect was refused, what is missing."""
        if self.accepted:  # unless it is saved, the folder still has the twin without it
            return command_on("compare", self.twin, ANOTHER_DAY) if self.saved_to else ""
        if self.instead:
            return command_on("add", self.twin, self.recording, f"--effect={self.instead}")
        return command_on("diagnose", self.twin, self.recording)

    def remarks(self) -> list[str]:
        out = []
        if len(self.contributions) > 1:
            worth = "; ".join(
                f"{called(c.name, self.twin)} {c.error_without:.3g}" for c in self.contributions
            )
            out.append(f"Test error without each term, all else re-fitted, {self.unit}: {worth}.")
        for c in self.contributions:
            if c.drop[0] <= 0:
                name, error = called(c.name, self.twin), f"{c.error_without:.3g} {self.unit}"
                out.append(f"Without {name} the test error is no higher: {error}.")
        if self.instead and self.accepted:
            more = f"explains slightly more: test error {self.instead_error:.3g} {self.unit}"
            hardly = "This recording hardly distinguishes the two"
            out.append(f"{called(self.instead)} by itself {more}. {hardly}.")
        if self.at_bound:
            out.append(f"[yellow]at a bound:[/] {', '.join(self.at_bound)}")
        if self.accepted and self.objections:
            out.append(f"[yellow]warnings of the diagnosis:[/] {'; '.join(self.objections)}")
        if self.saved_to:
            out.append(f"Stored as version {self.twin.history[-1]['version']} of {self.saved_to}.")
        if self.accepted:
            out.append("Whether it holds is shown by another day's recording, to which nothing was fitted.")
        bench = [h["recording"] for h in self.twin.history if h["change"] == "calibrated"]
        if self.accepted and bench and "touch" in (self.after or {}):
            refit = f"`{command_on('calibrate', self.twin, bench[-1])}`"
            found = "This was found from touch, with the finger pressed"
            out.append(f"{found}; re-fit the free bend to the bench recording: {refit}.")
        return out

    def content(self) -> dict:
        out = super().content()
        out |= {"explains_more": self.instead and {"effect": self.instead, "test": self.instead_error}}
        if self.saved_to:
            out |= {"twin": self.saved_to, "version": self.twin.history[-1]["version"]}
        return out

    def page(self) -> Report:
        page = self.lead_page()
        for text in self.physics if self.accepted else ():
            page.text(text)
        if self.accepted and self.objections:
            page.text(f"**Warnings of the diagnosis:** {'; '.join(self.objections)}.")
        if self.before is not None:
            from lerobot_pneutac.reports.diagnosis import error_bars  # plotly

            steps = [(name, e["heldout"], e["heldout_ci95"], colour) for name, e, colour in self._steps()]
            page.figure(error_bars(steps, self.unit, self.noise_floor))
            page.table(self._errors())
            share = percent(self.reduction, self.reduction_ci95)
            page.text(f"Of the squared error above the noise {share} goes with all of it.")
        worth, fall = [], f"fall of the mean square, {self.unit}^2 (98 % interval)"
        for c in self.contributions:
            row = {"term": called(c.name, self.twin), "known cause": "yes" if c.known else ""}
            row |= {f"test error without it, {self.unit}": c.error_without, "with all": c.error_with}
            worth.append(row | {fall: "{:.3g} ({:.3g} to {:.3g})".format(*c.drop)})
        page.table(worth, "What each term is worth: the model is re-fitted without it.")
        page.table(parameter_rows(self.parameters or {}), "Fitted to all but the test part.")
        page.found(self.findings)
        return page

    def _steps(self) -> list[tuple[str, dict, str]]:
        steps = [("before", self.before, BEFORE)]
        steps += [(f"with known causes ({_plain(self.known)})", self.baseline, KNOWN)] * bool(self.known)
        steps += [(f"with {_plain(self._effects)}", self.after, AFTER)] * bool(self._effects)
        return [(name, e, colour) for name, e, colour in steps if e is not None]


def _plain(effects: Sequence[str]) -> str:
    return joined(map(called, effects)) if effects else ""


@one_thread
def add(
    twin: Twin,
    recording: Recording | Demonstrations,
    effect: str | Sequence[str] | Diagnosis | Path,
    *,
    seed: int = 0,
    anyway: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Addition:
    """Switches effects on; they are accepted where the test error falls significantly by them.

    The test blocks are seen by no fit and by no choice; the errors that are printed are theirs, and the lower
    1 % bound of the fall on them decides. Known causes that the recording shows (weight, payload, base pose,
    stretch) are fitted first, and effects are credited with what they add to these. A diagnosis' finding is
    taken whole, with its parameters. Neither twin nor recording is changed.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel, or demonstrations of a robot with the finger.
        effect: one or several names of effects or laws; or what `diagnose` found on this recording, itself or
            the folder that it was written to.
        seed: decides which part is held out, and the bootstrap.
        anyway: returns the twin with the effects although they were refused, as `unconfirmed`.
        progress: called with a text, the fits done and all of them.

    Raises:
        InputError: there is no such effect, the devices differ, or there are too few rows to fit at all.
    """
    if isinstance(effect, Diagnosis):
        o = effect.outcome
        return _whole(effect.study, twin, effect.to_dict(), (o.before, o.baseline, o.after), anyway)
    if isinstance(effect, Path):
        recording = same_body(twin, recording, "add to")
        result, twins = read_found(effect, twin, recording)
        study = study_of(twin, recording, result["seed"])
        study.prepare(result["selected"], result.get("data_breaks", ()))

        def model(t: Twin) -> FittedModel:
            return FittedModel(effects=tuple(t.effects), residual=study.residual(t), count=0, twin=t)

        return _whole(study, twin, result, [t and model(t) for t in twins], anyway)
    effects = [effect] if isinstance(effect, str) else list(effect)
    for e in effects:
        parameter = e in ("late_commands", "compliance")  # of a twin, no effects
        if not (parameter and isinstance(recording, Demonstrations)):
            get_effect(e)
        if effects.count(e) > 1 and not is_law(e):  # of a law there may be two, with constants of their own
            raise InputError(f"effect names '{e}' twice; give it once.")
    recording, steps = same_body(twin, recording, "add to"), Steps(progress)
    given = _given(effects, recording, seed)
    study = study_of(twin, recording, seed, adding=effects)
    reason = next(filter(None, map(study.refusal, effects)), "") or study.too_little()
    if reason:
        return Addition(accepted=False, reason=reason, twin=twin, findings=tuple(study.findings), **given)
    steps.expect(f"fitting with and without {given['effect']}", 2)
    found = study.refits(effects, steps)
    return _addition(study, twin, effects, found, given, anyway, named=True)


def _given(effects: Sequence[str], recording: Recording | Demonstrations, seed: int) -> dict[str, Any]:
    return {"effect": ", ".join(effects) or "nothing", "recording": str(recording.folder), "seed": seed}


def _whole(
    study, twin: Twin, result: Mapping, models: Sequence[FittedModel | None], anyway: bool
) -> Addition:
    selected = list(result["selected"])
    given = _given(selected, study.recording, study.seed)
    given |= {"objections": tuple(result.get("objections", ())), "diagnosed": True}
    reason = study.too_little() if selected else "Nothing was written: the diagnosis found nothing to add."
    if reason:
        return Addition(accepted=False, reason=reason, twin=twin, findings=tuple(study.findings), **given)
    contributions = [Contribution(**c) for c in result.get("contributions", ())]
    before, baseline, after = models
    assert before is not None and after is not None  # each diagnosis has both
    found = Refits(before, baseline or before, after, result.get("known_causes", []), contributions)
    decided = result["verdict"] in ("missing_effect", "insufficient_form")
    mechanisms = [Mechanism(m["cause"], tuple(m["ranked"].items()), ()) for m in result.get("mechanism", ())]
    return _addition(study, twin, selected, found, given, anyway, False, decided, mechanisms)


def _addition(study, twin, effects, found: Refits, given, anyway, named, decided=True, mechanisms=()):
    """The result of switching on effects, `named` by the user or found by a diagnosis that `decided`."""
    before, base, after = found.before, found.baseline, found.after
    reduction, interval = study.reduction(before, after)
    errors = [study.errors(m) | {"heldout_ci95": study.interval(m)} for m in (before, base, after)]
    of = {e: f"{e}: " * (len(effects) > 1) for e in effects}
    parameters = {of[e] + k: v for e in effects for k, v in study.parameters(after, e).items()}
    reason = _refusal(study, effects, found, named)
    if not reason and not decided:
        why = f"{_plain(effects)} only compensates for something that no known effect describes"
        mark = "--anyway stores it marked as unconfirmed"
        reason = f"Not added: the diagnosis is inconclusive; {why}. {mark}."
    kinds = {e: family_in(after.twin, e) for e in effects if e in after.effects}
    physics = (hedged(study.describe(after, e), kind, mechanisms) for e, kind in kinds.items())
    return Addition(
        accepted=not reason,
        unconfirmed=bool(reason) and anyway,
        reason=reason,
        instead=found.better[0] if found.better else "",
        instead_error=study.errors(found.better[1])["heldout"] if found.better else None,
        twin=study.twin_of(after) if not reason or anyway else twin,
        unit=study.unit,
        noise_floor=study.noise.value,
        before=errors[0],
        baseline=errors[1],
        after=errors[2],
        known=tuple(found.known),
        contributions=tuple(found.contributions),
        reduction=reduction,
        reduction_ci95=interval,
        parameters=parameters,
        at_bound=tuple(sorted(study.at_bound(after, effects))),
        not_identified=after.not_identified,
        physics=tuple(physics),
        findings=tuple(study.findings),
        noted=study.noted(after),
        **given,
    )


def _refusal(study, effects: Sequence[str], found: Refits, named: bool) -> str:
    """Why effects are not added, a sentence; empty where they are."""
    base, after, unit = found.baseline if named else found.before, found.after, study.unit
    errors = [study.errors(m)["heldout"] for m in (base, after)]
    names, from_to = _plain(effects), f"from {errors[0]:.4g} to {errors[1]:.4g} {unit}"
    fall = study.test.paired(base.squared, after.squared, study.across_trials)
    if found.better is not None and fall.significant:
        other, model = found.better
        without, all_in, instead = (study.test.value(m.squared) for m in (found.baseline, after, model))
        if without - all_in <= T.NEARLY * (without - instead):  # else the effects remove nearly as much
            lower = f"{called(other)} lowers it to {study.errors(model)['heldout']:.4g} {unit}"
            but = f"{lower} and leaves nothing to {names}"
            return f"Not added: {names} lowers the test error {from_to}, but {but}."
    if idle := [e for e in effects if study.idle(after, e)]:
        plural = "their constants end where they do" if len(idle) > 1 else "its constants end where it does"
        return f"Not added: {_plain(idle)} changes nothing; {plural} nothing{_known_help(study, found)}."
    if named and fall.significant and not found.significant:
        why = "but cross-validation on the other blocks does not confirm it"
        return f"Not added: with {names} the test error falls {from_to}, {why}{_known_help(study, found)}."
    if not fall.significant and fall.value <= 0:
        why = f"the test error does not fall: it goes {from_to}"
        return f"Not added: with {names} {why}{_known_help(study, found)}."
    if not fall.significant:
        return _not_yet(study, names, errors, fall) + _known_help(study, found) + "."
    if found.doubts:
        return f"Not added: {next(iter(found.doubts.values()))}"
    useless = [c.name for c in found.contributions if c.name in effects and c.drop[1] <= 0]
    if named and len(effects) > 1 and useless:
        useful = [e for e in effects if e not in useless]
        instead = f"; give --effect={','.join(useful)}" if useful else "; give one of them alone"
        return f"Not added: {_plain(useless)} adds nothing significant to the others{instead}."
    return ""


def _not_yet(study, names: str, errors: Sequence[float], fall: PairedTest) -> str:
    """That an error falls, but not significantly, and how much more to record, without its full stop."""
    square = f"{study.unit}^2"
    text = (
        f"with {names} the test error falls from {errors[0]:.4g} to {errors[1]:.4g} {study.unit}, the mean "
        f"square error by {fall.value:.3g} [{fall.low:.3g} to {fall.high:.3g}] {square}"
    )
    if fall.value < T.WORTH_OF_CAUSE * errors[0] ** 2:
        share = f"{100 * T.WORTH_OF_CAUSE:.0f} %"
        return f"Not added: {text}, which is not significant and less than {share} of it"
    power = f"a fall of {fall.least:.3g} {square} with a power of {100 * T.POWER:.0f} %"
    more = f"{fall.units} test pieces show {power}, so record about {study.more_to_show(fall)}"
    stored = "--anyway stores it now, marked as unconfirmed"
    return f"Not added, as it is not significant yet: {text}. {more}; {stored}"


def _known_help(study, found: Refits) -> str:
    """The end of a sentence, where known causes alone lower the error significantly."""
    if not found.known or study.test.drop(found.before.squared, found.baseline.squared)[1] <= 0:
        return ""
    before, base = (study.errors(m)["heldout"] for m in (found.before, found.baseline))
    lower, them = ("cause {} lowers", "it") if len(found.known) == 1 else ("causes {} lower", "them")
    falls = f"the test error from {before:.4g} to {base:.4g} {study.unit}"
    return f". The known {lower.format(_plain(found.known))} {falls}; `pneutac calibrate` fits {them}"


@dataclass
class AddConfig(PairOptions):
    """Options of `pneutac add`.

    Attributes:
        twin: folder of the twin; its next version is written there if the test error falls significantly.
    """

    aliases: ClassVar = {"from": "diagnosis"}

    effect: str = ""  # names of the effects or laws to switch on, joined by commas
    # folder that `pneutac diagnose` wrote; all that it found is switched on. Also `--from`
    diagnosis: Path | None = None
    anyway: bool = False  # stores it although the error does not fall significantly, marked as unconfirmed
    seed: int = 0  # seed of the data split and of the bootstrap

    def __post_init__(self):
        if bool(self.effect) == (self.diagnosis is not None):
            either = "Give either the effects, --effect=A,B, or all that a diagnosis found, --from=DIR"
            raise InputError(f"{either}; `pneutac diagnose --out=DIR` finds what is missing.")


def command(cfg: AddConfig, terminal: Terminal) -> None:
    effects = [e.strip() for e in cfg.effect.split(",")] if cfg.effect else []
    for e in effects:
        get_effect(e)
    twin, recording = load_pair(cfg.twin, cfg.recording, "add to", cfg.task, cfg.station)
    check_writable(cfg.twin, f"--twin={cfg.twin}")
    result = terminal.run(add, twin, recording, cfg.diagnosis or effects, **keywords(cfg, add))
    stored = result.accepted or result.unconfirmed
    terminal.finish(result, cfg.out, stored, cfg.twin if stored else None)
    if not stored:
        raise InputError(result.reason)
