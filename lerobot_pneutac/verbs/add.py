"""Switches an effect on in a twin, re-fits everything and tells the error before and after."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.reports.page import Report, span
from lerobot_pneutac.reports.sentences import percent
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.by_device import study_of
from lerobot_pneutac.study.pair import same_body
from lerobot_pneutac.verbs.diagnosis import Diagnosis
from lerobot_pneutac.verbs.found import read_found
from lerobot_pneutac.verbs.result import Result, command_on
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.recording.noise import noise_text
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.twin import Twin

OF_DEMONSTRATIONS = ("late_commands", "compliance")  # parameters of a twin, no effects


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Addition(Result):
    """What switching an effect on did.

    Attributes:
        effect: its name.
        accepted: whether the error falls for sure where nothing was fitted.
        reason: why it was refused, a sentence; empty where it was accepted.
        twin: with the effect, re-fitted and not yet written; the one that was given where it was refused.
        unit: of the errors.
        noise_floor: error that the measurement's own noise makes; None where it is unknown.
        before: error without the effect: `train`, `heldout`, `heldout_ci95`; None where nothing was fitted.
        after: the same with it.
        reduction: share of the avoidable error that it removes.
        reduction_ci95: its interval.
        parameters: name to `value`, `ci95` and `unit`.
        at_bound: parameters stopped by a bound.
        not_identified: parameters that the recording cannot tell, and why.
        physics: what the effect does to this device, a sentence with the fitted numbers.
        findings: of the data check, one sentence each.
        objections: of the diagnosis that found it, one phrase each; empty where an effect was named.
        noted: what the twin's history keeps of it beside the errors.
        recording: that was used.
        seed: that decided what was held out.
        saved_to: the twin's folder once it was saved.
    """

    effect: str
    accepted: bool
    reason: str
    twin: Twin
    recording: str
    seed: int
    unit: str = ""
    noise_floor: float | None = None
    before: dict | None = None
    after: dict | None = None
    reduction: float = 0.0
    reduction_ci95: tuple[float, float] = (0.0, 0.0)
    parameters: dict[str, dict] | None = None
    at_bound: tuple[str, ...] = ()
    not_identified: dict[str, str] | None = None
    physics: str = ""
    findings: tuple[str, ...] = ()
    objections: tuple[str, ...] = ()
    noted: dict | None = None
    saved_to: Path | None = None

    def save(self, folder: str | Path) -> "Addition":
        """Writes the twin as the next version of `folder`; returns the result that knows where it lies."""
        twin = self.twin.copy()
        after = self.after or {}
        errors = {k: after[k] for k in ("train", "heldout", "arm_and_gauge", "touch") if k in after}
        if "touch" in after:  # of demonstrations, which others of the same finger are held against
            errors["heldout_ci95"] = list(after["heldout_ci95"])
        errors |= {"unit": self.unit, "seed": self.seed} | (self.noted or {})
        twin.save_version(folder, f"added {self.effect}", self.recording, errors)
        return replace(self, twin=twin, saved_to=Path(folder))

    @property
    def title(self) -> str:
        """Heading of table and report."""
        return f"Added {self.effect}" if self.accepted else f"{self.effect} was not added"

    @property
    def sentence(self) -> str:
        """What the effect does and by how much the error fell, or why it was refused."""
        before, after = self.before, self.after
        if not self.accepted or before is None or after is None:
            return self.reason
        share = percent(self.reduction, self.reduction_ci95)
        return (
            f"{self.physics} With {self.effect} the test error fell from {before['heldout']:.3g} to "
            f"{after['heldout']:.3g} {self.unit}: {share} of what could be avoided."
        )

    def rows(self) -> list[dict]:
        """The error before and after."""
        rows = []
        for name, e in (("before", self.before), (f"with {self.effect}", self.after)):
            if e is not None:
                row = {
                    f"error, {self.unit} (noise {noise_text(self.noise_floor)})": name,
                    "train": e["train"],
                }
                row |= {"test": e["heldout"], "95 % interval": span(e["heldout_ci95"])}
                rows.append(row | ({"contact": e["heldout_contact"]} if "heldout_contact" in e else {}))
        return rows

    def subject(self) -> tuple[Twin, str]:
        """The twin as it is now, and what it was fitted to."""
        return self.twin, self.recording

    @property
    def next_command(self) -> str:
        """To see where it still fails; where the effect was refused, what is missing."""
        return command_on("compare" if self.accepted else "diagnose", self.twin, self.recording)

    def remarks(self) -> list[str]:
        """Bounds, what speaks against it, and where the twin lies."""
        out = [f"[yellow]at a bound:[/] {', '.join(self.at_bound)}"] if self.at_bound else []
        if self.accepted and self.objections:
            out.append(f"[yellow]the diagnosis objects:[/] {'; '.join(self.objections)}")
        if self.saved_to:
            out.append(f"wrote version {self.twin.history[-1]['version']} of {self.saved_to}")
        bench = [h["recording"] for h in self.twin.history if h["change"] == "calibrated"]
        if self.accepted and bench and "touch" in (self.after or {}):
            out.append(
                "Touch told this of the pressed finger; the bench tells more of its free bend, with the new "
                f"effects too: `{command_on('calibrate', self.twin, bench[-1])}`."
            )
        return out

    def to_dict(self) -> dict:
        """The content of `result.json`."""
        saved = {}
        if self.saved_to:
            saved = {"twin": self.saved_to, "version": self.twin.history[-1]["version"]}
        return {
            "effect": self.effect,
            "accepted": self.accepted,
            "reason": self.reason,
            "unit": self.unit,
            "noise_floor": self.noise_floor,
            "before": self.before,
            "after": self.after,
            "reduction": self.reduction,
            "reduction_ci95": list(self.reduction_ci95),
            "parameters": self.parameters,
            "at_bound": sorted(self.at_bound),
            "not_identified": self.not_identified,
            "checks": list(self.findings),
            "objections": list(self.objections),
            **saved,
        }

    def page(self) -> Report:
        """The error before and after, and the parameters."""
        page = Report(self.title)
        page.lead(self.sentence)
        if self.accepted and self.objections:
            page.text(f"**The diagnosis objects:** {'; '.join(self.objections)}.")
        if self.before is not None:
            page.figure(self._figure())
            page.table(self.rows())
        page.table(
            [
                {
                    "parameter": k,
                    "value": v["value"],
                    "95 % interval": span(v["ci95"], "held"),
                    "unit": v["unit"] or "(a ratio)",
                }
                for k, v in (self.parameters or {}).items()
            ],
            "Fitted to the training part.",
        )
        if self.findings:
            page.heading("What the data check found")
            page.text("\n\n".join(self.findings))
        return page

    def _figure(self):
        import plotly.graph_objects as go

        figure = go.Figure()
        for name, e, colour in (("before", self.before, "#9aa5b1"), ("after", self.after, "#0b6e99")):
            if e is None:
                continue
            a, b = e["heldout_ci95"]
            error = {"type": "data", "array": [b - e["heldout"]], "arrayminus": [e["heldout"] - a]}
            figure.add_bar(x=[name], y=[e["heldout"]], error_y=error, marker_color=colour, showlegend=False)
        if self.noise_floor is not None:
            figure.add_hline(y=self.noise_floor, line_dash="dash", annotation_text="noise")
        return figure.update_yaxes(title=f"test error ({self.unit})", rangemode="tozero")


def add(
    twin: Twin,
    recording: Recording | Demonstrations,
    effect: str | Sequence[str] | Diagnosis | Path,
    *,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Addition:
    """Switches effects on; they are accepted where the error surely falls on blocks that no fit saw.

    A diagnosis' finding is taken whole, with its parameters. Effects that are named are fitted, beside the
    paper's base and the body's own, and judged on blocks that their fit did not see. The errors are those of
    test blocks. Neither twin nor recording is changed.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel, or demonstrations of a robot with the finger.
        effect: one or several names of effects or laws; or what `diagnose` found on this recording, itself or
            the folder that it was written to.
        seed: decides which part is held out, and the bootstrap.
        progress: called with a text, the fits done and all of them.

    Raises:
        InputError: there is no such effect, the devices differ, or there are too few rows to fit at all.
    """
    if isinstance(effect, Diagnosis):
        o, study = effect.outcome, effect.study
        # Anew, as the twin itself would have it: a search may predict from what it computed before.
        after = replace(o.after, residual=study.residual(o.after.twin))
        return _whole(study, twin, o.selected, o.before, after, o.evidence.objections)
    if isinstance(effect, Path):
        return _written(twin, same_body(twin, recording, "add to"), effect)
    effects = [effect] if isinstance(effect, str) else list(effect)
    for e in effects:
        if not (isinstance(recording, Demonstrations) and e in OF_DEMONSTRATIONS):
            get_effect(e)
    recording, steps = same_body(twin, recording, "add to"), Steps(progress)
    given = {"effect": ", ".join(effects), "recording": str(recording.folder), "seed": seed}
    study = study_of(twin, recording, seed, adding=effects)
    reason = next(filter(None, map(study.refusal, effects)), "") or study.too_little()
    if reason:
        return Addition(accepted=False, reason=reason, twin=twin, findings=tuple(study.findings), **given)
    steps.expect(f"fitting with and without {given['effect']}", 2)
    before = study.refit(study.own, None, steps)
    after = study.refit((*study.own, *effects), before, steps)
    return _judged(study, twin, effects, before, after, study.fall(before, after), given)


def _written(twin: Twin, recording: Recording | Demonstrations, folder: Path) -> Addition:
    """All that a diagnosis wrote to a folder, judged on its own blocks."""
    written = read_found(folder, recording)
    study = study_of(twin, recording, written.told["seed"])
    study.judges(written.told["selected"])
    before, after = (
        FittedModel(effects=tuple(t.effects), residual=study.residual(t), count=0, twin=t)
        for t in (written.before, written.found)
    )
    told = written.told
    return _whole(study, twin, told["selected"], before, after, told.get("objections", []))


def _whole(
    study, twin: Twin, selected: list[str], before: FittedModel, after: FittedModel, objections: Sequence[str]
) -> Addition:
    """All that a diagnosis found, judged on its test blocks."""
    folder = str(study.recording.folder)
    given = {"effect": ", ".join(selected) or "nothing", "recording": folder, "seed": study.seed}
    given["objections"] = tuple(objections)
    reason = study.too_little() if selected else "Nothing was written: the diagnosis found nothing to add."
    if reason:
        return Addition(accepted=False, reason=reason, twin=twin, findings=tuple(study.findings), **given)
    fall = study.test.drop(before.squared, after.squared)
    return _judged(study, twin, selected, before, after, fall, given)


def _judged(study, twin, effects, before, after, fall, given) -> Addition:
    """The result of switching these effects on."""
    reduction, interval = study.reduction(before, after)
    accepted = fall[1] > 0
    error, new_error = (study.errors(m) | {"heldout_ci95": study.interval(m)} for m in (before, after))
    several = len(effects) > 1
    parameters = {
        f"{e}: {k}" if several else k: v for e in effects for k, v in study.parameters(after, e).items()
    }
    return Addition(
        accepted=accepted,
        reason="" if accepted else _no_sure_fall(study, given["effect"], error, new_error, fall),
        twin=study.twin_of(after) if accepted else twin,
        unit=study.unit,
        noise_floor=study.noise.value,
        before=error,
        after=new_error,
        reduction=reduction,
        reduction_ci95=interval,
        parameters=parameters,
        at_bound=tuple(study.at_bound(after, effects)),
        not_identified=after.not_identified,
        physics=" ".join(study.describe(after, e) for e in effects if e in after.effects),
        findings=tuple(study.findings),
        noted=study.noted(after),
        **given,
    )


def _no_sure_fall(study: EffectStudy, effect: str, before: dict, after: dict, fall: tuple) -> str:
    value, low, high = fall
    return (
        f"Nothing was written: with {effect} the test error goes from {before['heldout']:.4g} to "
        f"{after['heldout']:.4g} {study.unit}, and the change of its square, {-value:+.3g} "
        f"[{-high:+.3g} to {-low:+.3g}] {study.unit}^2, is no sure fall; `pneutac diagnose` tells what is "
        "missing."
    )
