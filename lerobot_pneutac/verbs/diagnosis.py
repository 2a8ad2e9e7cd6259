"""The result of a diagnosis, for every kind of device."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from rich.markup import escape

from lerobot_pneutac.diagnosis.experiment import Separation
from lerobot_pneutac.diagnosis.result import PROFILE, Candidate, Outcome
from lerobot_pneutac.diagnosis.verdict import Explained
from lerobot_pneutac.reports import sentences
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import Confidence, State, next_experiment
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.verbs.result import Result, command_on
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.recording.noise import noise_text
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, option
from pneutac_sim.files import write_json
from pneutac_sim.twin import Twin

FILE = "contenders.json"  # the models between which a diagnosis could not yet choose
BEFORE, BASELINE, FOUND = "before", "baseline", "found"  # folders of twins in that of the report


@dataclass(frozen=True)
class WrittenDiagnosis:
    """A diagnosis in a folder.

    Attributes:
        before: the twin as it was, re-fitted.
        baseline: with the known causes that the recording shows; None where there are none.
        found: the twin with all that was found.
    """

    result: Mapping
    before: Twin
    baseline: Twin | None
    found: Twin


def read_found(folder: str | Path, recording: Recording | Demonstrations) -> WrittenDiagnosis:
    """Reads what `pneutac diagnose --out=FOLDER` wrote.

    Raises:
        InputError: the folder holds no diagnosis, or one of another recording.
    """
    file = Path(folder) / "result.json"
    if not file.is_file():
        raise InputError(
            f"There is no diagnosis at '{folder}'; make one with `pneutac diagnose {option('out', folder)}`."
        )
    result = json.loads(file.read_text())
    if "verdict" not in result or not (Path(folder) / FOUND).is_dir():
        raise InputError(f"{file} is not the result of a body's diagnosis; give the folder that it wrote.")
    if result["rows"] != len(recording):
        raise InputError(
            f"{file} is of a recording of {result['rows']} rows and {recording.folder} has {len(recording)}; "
            "give the recording that was diagnosed."
        )
    before, baseline, found = (Path(folder) / name for name in (BEFORE, BASELINE, FOUND))
    known = Twin.load(baseline) if baseline.is_dir() else None
    return WrittenDiagnosis(result, Twin.load(before, calibrated=False), known, Twin.load(found))


def described(contenders: Sequence[Candidate]) -> list[dict]:
    """Terms and probability of each."""
    return [{"terms": list(c.terms), "probability": c.probability} for c in contenders]


def save_contenders(folder: str | Path, contenders: Sequence[Candidate]) -> None:
    """Writes their twins, and last what they are."""
    for i, c in enumerate(contenders):
        c.twin.save(Path(folder) / "contenders" / str(i))
    write_json(Path(folder) / FILE, described(contenders))


def load_contenders(folder: "str | Path | Diagnosis") -> list[Candidate]:
    """Those of a diagnosis, or what `save_contenders` wrote; raises InputError where there is nothing."""
    if isinstance(folder, Diagnosis):
        return list(folder.outcome.contenders)
    file = Path(folder) / FILE
    if not file.is_file():
        raise InputError(f"There is no {file}; give the folder that `pneutac diagnose --out=` wrote.")
    stored = json.loads(file.read_text())
    return [
        Candidate(Twin.load(Path(folder) / "contenders" / str(i)), tuple(c["terms"]), c["probability"])
        for i, c in enumerate(stored)
    ]


def named_terms(contender: Candidate) -> str:
    """Its terms in words."""
    return " + ".join(map(sentences.called, contender.terms)) or "no effect"


SHOWN = 3  # warnings on the console; the report has all


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

    keys = (
        ("explained", "outcome.explained.value"), "mechanism",
        "verdict", "sentence", ("confidence", "confidence.value"), "warnings", "do_next",
        ("unit", "study.unit"), ("noise_floor", "study.noise.value"), ("noise_floor_how", "study.noise.how"),
        ("baseline", "before"),
        "selected", ("known_causes", "outcome.known"), ("contributions", "outcome.contributions"),
        ("run_terms", "outcome.run_terms"), "after", ("at_bound", "outcome.evidence.at_bound"),
        ("likely_right", "outcome.likely_right"), ("objections", "outcome.evidence.objections"), "findings",
        "next_experiment", ("rows", "study.given_rows"), ("seed", "study.seed"),
        ("seconds", "outcome.seconds"), ("time", "made_at"),
    )  # fmt: skip

    @property
    def twin(self) -> Twin:
        """The twin with all that was found, as `add` would write it."""
        return self.study.twin_of(self.outcome.after)

    @property
    def verdict(self) -> str:
        return self.outcome.verdict

    @property
    def explained(self) -> Explained:
        return self.outcome.explained

    @property
    def mechanism(self) -> list[dict]:
        """Of each cause the families that it may be with their probabilities, and whether it is certain."""
        return [
            {"cause": m.cause, "ranked": dict(m.ranked), "certain": m.certain}
            for m in self.outcome.mechanisms
        ]

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
        return self._next[0]

    @property
    def findings(self) -> tuple[str, ...]:
        return tuple(self.study.findings)

    @property
    def findings_shown(self) -> tuple[str, ...]:
        return ()

    @property
    def title(self) -> str:
        return f"test error, {self.study.unit} (noise {noise_text(self.study.noise.value)})"

    @cached_property
    def state(self) -> State:
        """All that the sentences depend on."""
        return sentences.state_of(self.study, self.outcome)

    @property
    def sentence(self) -> str:
        """The causes by size, the error and one confidence word."""
        return sentences.headline(self.state)

    @property
    def confidence(self) -> Confidence:
        """`confirmed`, `likely`, `explained but unnamed` or `inconclusive`."""
        return self.state.confidence

    @property
    def warnings(self) -> list[str]:
        """What speaks against the headline, what it leaves open and what the recording lacks."""
        return sentences.warnings(self.state)

    @property
    def do_next(self) -> str:
        """One command or one experiment."""
        return sentences.do_next(self.state, self._add_command)

    def subject(self) -> tuple[Twin, Path]:
        return self.study.twin, self.study.recording.folder

    @property
    def _add_command(self) -> str:
        named = [e for e in self.selected if e != PROFILE]
        found = f"--from={self.saved_to}" if self.saved_to else f"--effect={','.join(named)}"
        return command_on("add", *self.subject(), found)

    @property
    def next_command(self) -> str:
        return self.do_next if self.do_next == self._add_command else ""

    def rows(self) -> list[dict]:
        o, rows = self.outcome, [("before", self.before)]
        if o.baseline is not None and o.known:
            rows.append(("with known causes", self.study.errors(o.baseline)))
        if self.selected or o.known:
            rows.append(("with all", self.after))
        worth = sorted(o.contributions, key=lambda c: -c.drop[0])
        rows += [(f"without {c.name}", {"heldout": c.error_without}) for c in worth] if len(worth) > 1 else []
        contact = any("heldout_contact" in errors for _, errors in rows)
        return [
            {"model": name, "error": f"{errors['heldout']:.3g}"}
            | ({"in the contact": f"{errors['heldout_contact']:.3g}"} if contact else {})
            for name, errors in rows
        ]

    def remarks(self) -> list[str]:
        shown = self.warnings
        more = [f"- {len(shown) - SHOWN} more in the report (--out=DIR)"] if len(shown) > SHOWN else []
        said = [*(f"- {escape(w)}" for w in shown[:SHOWN]), *more]
        return [*(["[bold]Warnings[/]", *said] if said else []), f"[bold]Do next:[/] {escape(self.do_next)}"]

    def content(self) -> dict:
        o, e, study = self.outcome, self.outcome.evidence, self.study
        return super().content() | {
            "with_known_causes": None if o.baseline is None else study.errors(o.baseline),
            "reduction": self.reduction[0],
            "reduction_ci95": self.reduction[1],
            "parameters": {n: study.as_written(study.parameters(o.after, n)) for n in o.selected},
            "ladder": [{"change": label, **study.errors(model)} for label, model in o.ladder],
            "effects": [
                {"name": t.name, **t.errors, "reduction": t.reduction, "reduction_ci95": t.ci95}
                | {"parameters": study.as_written(t.parameters), "tested_by": t.tested_by}
                for t in o.tested
            ]
            + [
                {"name": u.name, "heldout": None, "reduction": None, "reduction_ci95": None}
                | {"parameters": {}, "tested_by": u.reason}
                for u in study.untested
            ],
            "indistinguishable": [[r.effect, r.rival] for r in o.rivals],
            "chosen_in": {n: o.chosen_in.get(n, 1.0) for n in o.selected},
            "error_over_noise": {"before": e.before, "after": e.after},
            "black_box": {"share_of_rest": e.left_to_black_box, "unfinished": e.unfinished},
            **study.details(o),
        }

    def save(self, folder: str | Path) -> "Diagnosis":
        """Writes twins into folders of `folder`; returns the result that knows where.

        Those before and after are for `add --from`, those of all candidates for `design`.
        """
        self.study.twin_of(self.outcome.before).save(Path(folder) / BEFORE)
        if self.outcome.baseline is not None:
            self.study.twin_of(self.outcome.baseline).save(Path(folder) / BASELINE)
        self.twin.save(Path(folder) / FOUND)
        save_contenders(folder, self.outcome.contenders)
        return replace(self, saved_to=Path(folder))

    def page(self) -> Report:
        from lerobot_pneutac.reports.diagnosis import diagnosis_page

        return diagnosis_page(self, self._next[1])
