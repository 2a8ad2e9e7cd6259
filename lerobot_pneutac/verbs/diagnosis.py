"""What a diagnosis tells, whatever the device."""

import time
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from lerobot_pneutac.diagnosis.experiment import Separation
from lerobot_pneutac.diagnosis.result import Outcome, Tested
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import how_sure, lead, next_experiment, not_explained, percent
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.verbs.contenders import save_contenders
from lerobot_pneutac.verbs.found import BEFORE, FOUND
from lerobot_pneutac.verbs.result import Result, command_on
from pneutac_datasets.recording.noise import noise_text
from pneutac_sim.twin import Twin

LITTLE_ALONE = 0.03  # share of the avoidable error: an effect that alone removes less looks like nothing


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Diagnosis(Result):
    """What a twin lacks to explain a recording.

    Attributes:
        study: the data and how they were shared.
        outcome: everything that was found.
        saved_to: folder with the twins before and after, once they were saved.
        made_at: date and time.
    """

    study: EffectStudy
    outcome: Outcome
    saved_to: Path | None = None
    made_at: str = field(default_factory=lambda: time.strftime("%Y-%m-%d %H:%M"))

    @property
    def twin(self) -> Twin:
        """The twin with all that was found, as `add` would write it."""
        return self.study.twin_of(self.outcome.after)

    @property
    def verdict(self) -> str:
        """`adequate`, `missing_effect`, `insufficient_form`, `unknown_effect` or `ambiguous`."""
        return self.outcome.verdict

    @property
    def selected(self) -> list[str]:
        """Effects found, the most important first."""
        return self.outcome.selected

    @property
    def before(self) -> dict[str, float]:
        """Root mean square errors of the twin as it is, `train` and `heldout`."""
        return self.study.errors(self.outcome.before)

    @property
    def after(self) -> dict[str, float]:
        """The same with all effects found."""
        return self.study.errors(self.outcome.after)

    @cached_property
    def reduction(self) -> tuple[float, tuple[float, float]]:
        """Share of the avoidable error that all found effects remove, with its 95 % interval."""
        if not self.selected:
            return 0.0, (0.0, 0.0)
        return self.study.reduction(self.outcome.before, self.outcome.after)

    @cached_property
    def _next(self) -> tuple[str, Separation | None]:
        return next_experiment(self.study, self.outcome)

    @property
    def next_experiment(self) -> str:
        """What to record next."""
        return self._next[0]

    @property
    def findings(self) -> tuple[str, ...]:
        """What the data check found, one sentence each."""
        return tuple(self.study.findings)

    @property
    def title(self) -> str:
        """Heading of the table."""
        return f"error on test blocks, {self.study.unit} (noise {noise_text(self.study.noise.value)})"

    @property
    def sentence(self) -> str:
        """What was found, in a sentence or two."""
        return lead(self.study, self.outcome)

    @property
    def how_sure(self) -> str:
        """How far what was found can be trusted."""
        return how_sure(self.study, self.outcome)

    @property
    def not_explained(self) -> str:
        """What stays, and what could not be looked for."""
        return not_explained(self.study, self.outcome)

    def subject(self) -> tuple[Twin, Path]:
        """The twin as it was given, and the recording."""
        return self.study.twin, self.study.recording.folder

    @property
    def next_command(self) -> str:
        """To add what was found; where nothing was, to see where the twin fails."""
        if not self.selected:
            return command_on("compare", *self.subject())
        found = f"--from={self.saved_to}" if self.saved_to else f"--effect={','.join(self.selected)}"
        return command_on("add", *self.subject(), found)

    def rows(self) -> list[dict]:
        """The effects found and some others."""
        chosen = [t for t in self.outcome.tested if t.name in self.selected]
        rest = [t for t in self.outcome.tested if t.name not in self.selected][: max(2, 6 - len(chosen))]
        rows = [("(re-fitted)", self.before, "", "", "")]
        for t in chosen + rest:
            shown = [(k, v["value"]) for k, v in t.parameters.items() if k != "scale_kpa"][:3]
            values = ", ".join(f"{k} {value:.3g}" for k, value in shown)
            share = "" if t.reduction is None or t.ci95 is None else percent(t.reduction, t.ci95)
            rows.append((t.name, t.errors, share, values, self._how_found(t)))
        if self.selected:
            rows.append(("(all found)", self.after, "", "", ""))
        out = []
        for name, errors, share, values, how in rows:
            contact = errors.get("heldout_contact")
            row = {"effect": name, "test": f"{errors['heldout']:.3g}"}
            row |= {} if contact is None else {"contact": f"{contact:.3g}"}
            out.append(row | {"alone removes": share, "constants": values, "": how})
        return out

    def _how_found(self, t: Tested) -> str:
        """Some effects show only once others are there."""
        if t.reduction is None:
            return "in the twin; error without it"
        if t.name not in self.selected:
            return ""
        return "found" if t.reduction > LITTLE_ALONE or len(self.selected) == 1 else "found, with the others"

    def remarks(self) -> list[str]:
        """How sure it is, what is not explained, the next experiment, what was not tested, the verdict."""
        return [
            f"[bold]How sure:[/] {self.how_sure}",
            f"[bold]Not explained:[/] {self.not_explained}",
            *self.study.caveats(self.outcome),
            f"[bold]Record next:[/] {self.next_experiment}",
            *(f"  {u.name}: {u.reason}" for u in self.study.untested),
            f"verdict: {self.verdict}   ({self.outcome.seconds:.0f} s)",
        ]

    def to_dict(self) -> dict:
        """The content of `result.json`."""
        o, study = self.outcome, self.study
        return {
            "verdict": o.verdict,
            "sentence": self.sentence,
            "how_sure": self.how_sure,
            "not_explained": self.not_explained,
            "unit": study.unit,
            "noise_floor": study.noise.value,
            "noise_floor_how": study.noise.how,
            "baseline": self.before,
            "selected": o.selected,
            "after": self.after,
            "reduction": self.reduction[0],
            "reduction_ci95": list(self.reduction[1]),
            "parameters": {e: study.as_written(study.parameters(o.after, e)) for e in o.selected},
            "ladder": [{"change": label, **study.errors(model)} for label, model in o.ladder],
            "effects": [_tested(t, study) for t in o.tested] + [_untested(u) for u in study.untested],
            "indistinguishable": [[r.effect, r.rival] for r in o.rivals],
            "chosen_in": {e: o.chosen_in.get(e, 1.0) for e in o.selected},
            "at_bound": o.evidence.at_bound,
            "error_over_noise": {k: getattr(o.evidence, k) for k in ("before", "after")},
            "black_box": {
                "share_of_rest": o.evidence.left_to_black_box,
                "unfinished": o.evidence.unfinished,
            },
            "likely_right": o.likely_right,
            "objections": o.evidence.objections,
            "findings": list(self.findings),
            "notes": study.caveats(o),
            "next_experiment": self.next_experiment,
            "rows": len(study.recording),
            "seed": study.seed,
            "seconds": o.seconds,
            "time": self.made_at,
            **study.details(o),
        }

    def save(self, folder: str | Path) -> "Diagnosis":
        """Writes twins into folders of `folder`; returns the result that knows where.

        Those before and after are for `add --from`, those of all contenders for `design`.
        """
        self.study.twin_of(self.outcome.before).save(Path(folder) / BEFORE)
        self.twin.save(Path(folder) / FOUND)
        save_contenders(folder, self.outcome.contenders)
        return replace(self, saved_to=Path(folder))

    def page(self) -> Report:
        """The sentence, then the evidence as pictures."""
        from lerobot_pneutac.reports.diagnosis import diagnosis_page

        return diagnosis_page(self, self._next[1])


def _tested(t: Tested, study: EffectStudy) -> dict:
    interval = None if t.ci95 is None else list(t.ci95)
    return {
        "name": t.name, **t.errors, "reduction": t.reduction, "reduction_ci95": interval,
        "parameters": study.as_written(t.parameters), "tested_by": t.tested_by,
    }  # fmt: skip


def _untested(u) -> dict:
    return {
        "name": u.name, "heldout": None, "reduction": None, "reduction_ci95": None, "parameters": {},
        "tested_by": u.reason,
    }  # fmt: skip
