"""Which physical effect a twin lacks, with rivals, intervals and the next experiment."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

from rich.markup import escape

from lerobot_pneutac.cli.options import PairOptions, keywords
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis.design import Separation
from lerobot_pneutac.diagnosis.result import PROFILE, Candidate, Outcome
from lerobot_pneutac.diagnosis.search import Steps
from lerobot_pneutac.diagnosis.verdict import Explained
from lerobot_pneutac.reports import sentences
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import Confidence, State, next_experiment
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.pair import load_pair, same_body
from lerobot_pneutac.verbs.result import Result, command_on
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.recording.noise import noise_text
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, option
from pneutac_sim.executor import one_thread
from pneutac_sim.files import fits, read_json, together, write_json
from pneutac_sim.twin import Twin

# the models between which a diagnosis could not yet choose
FILE, CONTENDERS = "contenders.json", "contenders"
BEFORE, BASELINE, FOUND = "before", "baseline", "found"  # folders of twins in that of the report
SHOWN = 3  # warnings on the console, besides those of the recording; the report has all


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Diagnosis(Result):
    """What a twin lacks to explain a recording."""

    study: EffectStudy  # the data and how they were shared
    outcome: Outcome  # everything that was found
    saved_to: Path | None = None  # folder with the twins before and after, once they were saved
    made_at: str = field(default_factory=lambda: time.strftime("%Y-%m-%d %H:%M"))

    keys = (
        ("explained", "outcome.explained.value"), ("explained_where", "outcome.evidence.where"), "mechanism",
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
        """Of each cause the families that it may be, and whether the first is certain and is named."""
        return [
            {"cause": m.cause, "ranked": dict(m.ranked), "certain": m.certain, "named": m.named}
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

    def next_after(self, out: Path | None) -> str:
        return self.do_next

    def rows(self) -> list[dict]:
        o, rows = self.outcome, [("before, re-fitted", self.before)]
        if o.baseline is not None and o.known:
            rows.append(("with known causes", self.study.errors(o.baseline)))
        if self.selected or o.known:
            rows.append(("with all", self.after))
        worth = sorted(o.contributions, key=lambda c: -c.drop[0]) if len(o.contributions) > 1 else []
        rows += [(f"without {sentences.called(c.name, o.twin)}", {"heldout": c.error_without}) for c in worth]
        contact = any("heldout_contact" in errors for _, errors in rows)
        return [
            {"model": name, "error": f"{errors['heldout']:.3g}"}
            | ({"in the contact": f"{errors['heldout_contact']:.3g}"} if contact else {})
            for name, errors in rows
        ]

    def remarks(self) -> list[str]:
        shown = self.warnings
        # what is wrong with the recording may be all that was found
        first = [w for i, w in enumerate(shown) if i < SHOWN or w in self.state.notes]
        lines = [f"- {escape(w)}" for w in first]
        if len(shown) > len(first):
            where = "in the report" + " (--out=DIR)" * (self.saved_to is None)
            lines.append(f"- {len(shown) - len(first)} more {where}")
        return ["[bold]Warnings[/]", *lines] if lines else []

    def content(self) -> dict:
        o, e, study = self.outcome, self.outcome.evidence, self.study
        tested = [
            {"name": t.name, **t.errors, "reduction": t.reduction, "reduction_ci95": t.ci95}
            | {"parameters": study.as_written(t.parameters), "tested_by": t.tested_by}
            for t in o.tested
        ]
        unknown = {"heldout": None, "reduction": None, "reduction_ci95": None, "parameters": {}}
        untested = [{"name": u.name, **unknown, "tested_by": u.reason} for u in study.untested]
        return super().content() | {
            "with_known_causes": None if o.baseline is None else study.errors(o.baseline),
            "reduction": self.reduction[0],
            "reduction_ci95": self.reduction[1],
            "parameters": {n: study.as_written(study.parameters(o.after, n)) for n in o.selected},
            "ladder": [{"change": label, **study.errors(model)} for label, model in o.ladder],
            "effects": tested + untested,
            "indistinguishable": [[r.effect, r.rival] for r in o.rivals],
            "chosen_in": {n: o.chosen_in.get(n, 1.0) for n in o.selected},
            "error_over_noise": {"before": e.before, "after": e.after},
            "black_box": {"share_of_rest": e.left_to_black_box, "unfinished": e.unfinished},
            **study.details(o),
        }

    written = (BEFORE, BASELINE, FOUND, CONTENDERS, FILE)

    def write_more(self, folder: Path) -> None:
        """Writes twins: those before and after for `add --from`, those of all candidates for `design`.

        Of a gel the candidates alone are written.
        """
        o = self.outcome
        save_candidates(folder, o.contenders)
        if self.study.recording.device != "gel":
            for name, model in ((BEFORE, o.before), (BASELINE, o.baseline), (FOUND, o.after)):
                if model is not None:
                    self.study.twin_of(model).save(folder / name)

    def stored_in(self, folder: str | Path) -> "Diagnosis":
        """The result that knows in which folder its twins are; of a gel itself."""
        return self if self.study.recording.device == "gel" else replace(self, saved_to=Path(folder))

    def save(self, folder: str | Path) -> "Diagnosis":
        """Writes the twins into folders of `folder`; returns the result that knows where."""
        with together(Path(folder), self.written) as part:
            self.write_more(part)
        return self.stored_in(folder)

    def page(self) -> Report:
        from lerobot_pneutac.reports.diagnosis import diagnosis_page

        return diagnosis_page(self, self._next[1])


def read_found(
    folder: str | Path, twin: Twin, recording: Recording | Demonstrations
) -> tuple[dict, tuple[Twin, Twin | None, Twin]]:
    """Reads what `pneutac diagnose --out=FOLDER` wrote.

    Returns:
        Its result, and the twin as it was, re-fitted, with known causes (None where there are none), and
        with all that was found.

    Raises InputError: the folder holds no diagnosis, or one of another recording, twin or version of it.
    """
    folder = Path(folder)
    file = folder / "result.json"
    if not file.is_file():
        given = {"twin": twin.folder or "DIR", "recording": recording.folder, "out": folder}
        command = " ".join(option(name, value) for name, value in given.items())
        make = f"make one with `pneutac diagnose {command}`"
        raise InputError(f"There is no diagnosis at '{folder}'; {make}.")
    result = read_json(file)
    kinds = {"verdict": str, "selected": list[str], "seed": int}
    if not all(fits(k, result.get(n)) for n, k in kinds.items()) or not (folder / FOUND).is_dir():
        raise InputError(f"{file} is not the result of a body's diagnosis; give the folder that it wrote.")
    if (rows := result.get("rows")) != len(recording):
        both = f"{file} is of a recording of {rows} rows and {recording.folder} has {len(recording)}"
        raise InputError(f"{both}; give the recording that was diagnosed.")
    before = Twin.load(folder / BEFORE, calibrated=False)
    if before.history != twin.history:
        of = f"The diagnosis in '{folder}' is of an earlier version of the twin or of another one"
        pair = f"{option('twin', twin.folder or 'TWIN')} {option('recording', recording.folder)}"
        raise InputError(f"{of}; diagnose again: `pneutac diagnose {pair} --out=DIR`.")
    known = Twin.load(folder / BASELINE) if (folder / BASELINE).is_dir() else None
    return result, (before, known, Twin.load(folder / FOUND))


def described(candidates: Sequence[Candidate]) -> list[dict]:
    return [{"terms": list(c.terms), "probability": c.probability} for c in candidates]


def save_candidates(folder: str | Path, candidates: Sequence[Candidate]) -> None:
    """Writes their twins, and last what they are."""
    for i, c in enumerate(candidates):
        c.twin.save(Path(folder) / CONTENDERS / str(i))
    write_json(Path(folder) / FILE, described(candidates))


def load_candidates(folder: str | Path | Diagnosis) -> list[Candidate]:
    """Those of a diagnosis, or what `save_candidates` wrote; raises InputError where there is nothing."""
    if isinstance(folder, Diagnosis):
        return list(folder.outcome.contenders)
    file = Path(folder) / FILE
    if not file.is_file():
        raise InputError(f"There is no {file}; give the folder that `pneutac diagnose --out=` wrote.")
    stored = read_json(file, list)
    kinds = {"terms": list[str], "probability": float}
    if not all(isinstance(c, dict) and all(fits(k, c.get(n)) for n, k in kinds.items()) for c in stored):
        raise InputError(f"{file} is damaged; give the folder that `pneutac diagnose` wrote.")
    return [
        Candidate(Twin.load(Path(folder) / CONTENDERS / str(i)), tuple(c["terms"]), c["probability"])
        for i, c in enumerate(stored)
    ]


def named_terms(candidate: Candidate) -> str:
    return " + ".join(map(sentences.called, candidate.terms)) or "no effect"


@one_thread
def diagnose(
    twin: Twin,
    recording: Recording | Demonstrations,
    *,
    jobs: int = 0,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Diagnosis:
    """Finds what a twin lacks to explain a recording; neither is changed.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel, or demonstrations of a robot with the finger.
        jobs: number of threads; 0 for all cores.
        seed: seed of the data split and of every bootstrap.
        progress: called with a text, the fits done and all of them.

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """
    if jobs < 0:
        raise InputError(f"jobs={jobs} must be 0 (all cores) or a positive number.")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    study = study_of(twin, same_body(twin, recording, "diagnose"), seed)
    return Diagnosis(study=study, outcome=study.search(jobs or cores, Steps(progress)))


@dataclass
class DiagnoseConfig(PairOptions):
    """Options of `pneutac diagnose`.

    Attributes:
        twin: folder of the twin, which is not changed.
    """

    described_by: ClassVar = diagnose

    jobs: int = 0
    seed: int = 0


def command(cfg: DiagnoseConfig, terminal: Terminal) -> None:
    twin, recording = load_pair(cfg.twin, cfg.recording, "diagnose", cfg.task, cfg.station)
    result = terminal.run(diagnose, twin, recording, **keywords(cfg, diagnose))
    terminal.finish(result if cfg.out is None else result.stored_in(cfg.out), cfg.out)
