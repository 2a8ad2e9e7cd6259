"""Finds what a twin lacks at the bench: measure, search on everything, choose the next program, repeat."""

import math
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.cli.options import keywords
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis.design import NO_HANDS, Choice, Limits, choices, predict, read
from lerobot_pneutac.diagnosis.programs import (
    GRAVITY,
    Hands,
    first_program,
    instructions,
    named,
    refuse_unused,
)
from lerobot_pneutac.diagnosis.result import Candidate
from lerobot_pneutac.diagnosis.thresholds import NOISE
from lerobot_pneutac.reports.figures import curves, pressure_traces
from lerobot_pneutac.reports.page import HELDOUT, MEASURED, MODEL, TRAIN, Report, rows_of, save_table
from lerobot_pneutac.reports.sentences import called
from lerobot_pneutac.study.pair import same_body, same_chambers, same_length
from lerobot_pneutac.verbs.benches import Bench, StandinBench, check_bench, make_bench, program_columns
from lerobot_pneutac.verbs.diagnose import Diagnosis, diagnose, load_candidates
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.recording.recording import Recording, joined
from pneutac_datasets.recording.wording import joined as listed
from pneutac_sim.effects.laws import family
from pneutac_sim.errors import InputError, check_least
from pneutac_sim.executor import one_thread
from pneutac_sim.files import read_json, write_json
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.twin import Twin

KNOWN = ("adequate", "missing_effect")
CONFIRMS = 1.5  # error over noise, before it was used, up to which a recording confirms what predicted it
PREDICTED = "predicted.csv"  # in a round's folder: its program as predicted and as measured
LEFT = 1.15  # error over noise, on all that was measured, above which something unknown is at work


@dataclass(frozen=True)
class Round:
    """One program and what it taught."""

    number: int  # from 0
    program: str  # its name
    kind: str  # see `Choice`
    seconds: float  # of the program
    pause_s: float | None  # see `Bench`
    unit: str  # of the errors
    noise: float  # floor of the error
    predicted_error: float | None  # of this recording before it was used, by the best model then, if any
    bare_error: float | None  # the same by the twin as it was given, re-fitted
    # effect to the least such error without its kind of physics, by other models or by the best model without
    # it, gain and offset fitted to favour it
    without: dict[str, float]
    error: float  # on test blocks of everything measured so far, by the best model now
    verdict: str  # now
    selected: list[str]  # effects found now, the most important first
    sentence: str  # what was found
    probabilities: dict[str, float]  # each candidate's among the others, its terms joined by ` + `
    hand: str = ""  # what a hand had changed for it, see `programs.HANDS`; empty for nothing
    # effect to the number of the round whose recording was predicted with it, and not without
    needed_by: dict[str, int] = field(default_factory=dict)
    # those of them found while the form sufficed and noise alone was left: else a law may stand in for
    # another. A recording that `refutes` ends that
    confirmed_by: dict[str, int] = field(default_factory=dict)
    likely_right: float | None = None  # see `Outcome`

    @property
    def suffices(self) -> bool:
        return self.verdict in KNOWN and self.error <= LEFT * self.noise

    @property
    def foreseen(self) -> bool:
        """Whether this recording was predicted to the noise before it was used."""
        return self.predicted_error is not None and self.predicted_error <= NOISE * self.noise

    @property
    def refutes(self) -> bool:
        """Whether this recording was predicted badly, and nothing that was found then explains everything."""
        badly = self.predicted_error is not None and self.predicted_error > CONFIRMS * self.noise
        return badly and not self.suffices

    @property
    def unconfirmed(self) -> list[str]:
        return [e for e in self.selected if e not in self.confirmed_by]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Learning(Result):
    """What the bench taught, round by round."""

    twin: Twin  # with all that was found; its folder has a version for each round
    rounds: tuple[Round, ...]  # in order
    ended: str  # why there was no further round, a clause
    folder: Path  # where everything lies

    heading = "Learnt from the bench"
    keys = (
        "confirmed", ("confirmed_by", "last.confirmed_by"), ("selected", "last.selected"),
        ("verdict", "last.verdict"), "ended", "bench_s", "sentence", "rounds",
    )  # fmt: skip

    @property
    def last(self) -> Round:
        return self.rounds[-1]

    @property
    def confirmed(self) -> bool:
        """Whether a recording of another kind, predicted before it was used, needed each effect found."""
        if not self.last.selected:
            return self.last.verdict == "adequate" and self.last.foreseen
        return self.last.verdict in KNOWN and not self.last.unconfirmed

    @property
    def bench_s(self) -> float:
        return sum(r.seconds for r in self.rounds)

    @cached_property
    def sentence(self) -> str:
        r = self.last
        minutes = f"{self.bench_s / 60:.1f} minutes on the bench in {len(self.rounds)} programs"
        what = "nothing is missing" if self.confirmed else "nothing significant was found"
        if r.selected:
            proven = ("not yet confirmed", "confirmed by a program of another kind that needed it")
            found = (f"{called(e, self.twin)}, {proven[e in r.confirmed_by]}" for e in r.selected)
            what = f"the {self.twin.device} behaves like {'; like '.join(found)}"
        text = f"After {minutes}: {what}."
        if r.predicted_error is not None:
            times = f"{r.predicted_error / r.noise:.2g} times the noise"
            text += f" The last program was predicted to {r.predicted_error:.3g} {r.unit} before it was used"
            text += f" ({times})."
        return f"{text} It ended because {self.ended}."

    def rows(self) -> list[dict]:
        """Those of `_all_rows` that a terminal of 80 columns has room for."""
        left_out = ("as given", "noise", "verdict")
        return [{k: v for k, v in row.items() if k not in left_out} for row in self._all_rows()]

    def _all_rows(self) -> list[dict]:
        def found(r: Round) -> str:
            marked = (called(e, self.twin) + "*" * (e in r.confirmed_by) for e in r.selected)
            return ", ".join(dict.fromkeys(marked)) or "-"

        columns = {"round": "number", "program": "program", "s": "{0.seconds:.0f}"}
        columns |= {"predicted": "{0.predicted_error:.3g}", "as given": "{0.bare_error:.3g}"}
        columns |= {"after": "{0.error:.3g}", "noise": "{0.noise:.3g}"}
        ends = {"right": "{0.likely_right:.0%}", "verdict": "verdict"}
        parts = zip(rows_of(self.rounds, columns), self.rounds, rows_of(self.rounds, ends), strict=True)
        return [row | {"found": found(r)} | end for row, r, end in parts]

    def remarks(self) -> list[str]:
        unit, noise = self.last.unit, f"{self.last.noise:.3g}"
        return [
            f"predicted, after: error in {unit} before and after a program was used (noise {noise})",
            "right: share of test devices with a similar finding whose first-listed physics was right",
            "* confirmed: a recording of another kind was predicted with it before it was used",
            f"twin: {self.folder / 'twin'}, a version for each round",
        ]

    @property
    def next_command(self) -> str:
        newest = self.folder / f"round_{self.last.number}" / "recording"
        return f"pneutac compare --twin={self.folder / 'twin'} --recording={newest}"

    def page(self) -> Report:
        page = self.lead_page()
        at, unit = [r.number for r in self.rounds], self.last.unit
        lines = (
            ("predicted", at, [r.predicted_error for r in self.rounds], {"color": MODEL}),
            ("as given", at, [r.bare_error for r in self.rounds], {"color": HELDOUT}),
            ("after", at, [r.error for r in self.rounds], {"color": TRAIN, "dash": "dot"}),
            ("noise", at, [r.noise for r in self.rounds], {"color": MEASURED, "dash": "dash"}),
        )
        ahead = curves(lines, "round", f"error, {unit}", mode="lines+markers").update_xaxes(dtick=1)
        page.figure(
            ahead.update_yaxes(rangemode="tozero"),
            "Error on each program before it was used for anything, by the best model until then and by the "
            "twin as it was given, re-fitted, and the error of what was found after it, where no fit saw.",
        )
        page.table(self._all_rows(), "* confirmed by a program of another kind that was predicted with it.")
        count = len(self.rounds)
        figure = make_subplots(count, 1, vertical_spacing=0.25 / max(count, 2))
        for i, r in enumerate(self.rounds):
            table = pd.read_csv(self.folder / f"round_{r.number}" / "program.csv")
            commands = table[[c for c in table if c.startswith("pressure_cmd_")]].to_numpy(float)
            for trace in pressure_traces(table["time_s"], commands):
                trace.update(legendgroup=trace.name, showlegend=trace.showlegend and not i)
                figure.add_trace(trace, i + 1, 1)
            figure.update_yaxes(title_text=f"{r.number}, kPa", row=i + 1, col=1)
        figure.update_xaxes(title_text="time, s", row=count, col=1)
        page.figure(figure, "What was commanded.", 120 + 90 * count)
        figure = go.Figure()
        for r in self.rounds:
            for name, p in sorted(r.probabilities.items(), key=lambda item: -item[1]):
                label = " + ".join(map(called, name.split(" + "))) or "no effect"
                text = {"name": label, "hovertext": label, "text": label.split(" + ")[-1]}
                figure.add_bar(x=[r.number], y=[p], showlegend=False, **text)
        figure.update_layout(barmode="stack", yaxis_title="probability").update_xaxes(
            title_text="round", dtick=1
        )
        page.figure(figure, "How likely each model was after each round, by its last effects.")
        page.heading("What was found, round by round")
        for r in self.rounds:
            page.text(f"**Round {r.number}, {r.program}.** {r.sentence}")
            file = self.folder / f"round_{r.number}" / PREDICTED
            if file.is_file():
                table = pd.read_csv(file)
                names = [c.removesuffix(" measured") for c in table if c.endswith(" measured")]
                most = max(names, key=lambda n: np.ptp(table[f"{n} measured"]))
                kinds = (("predicted", MODEL), ("measured", MEASURED))
                lines = ((kind, table["time_s"], table[f"{most} {kind}"], colour) for kind, colour in kinds)
                page.figure(curves(lines, "time, s", most), "As predicted before it was measured.", 260)
        return page


SHARES = (0.0, 0.25, 0.5, 0.67, 1.5, 2.0, 3.0, 4.0)  # of the weight that was asked for, tried
CLEARLY = 0.7  # of the error with what was asked for: below, it was something else


def error_of(twin: Twin, recording: Recording, rows: slice = slice(None), favour: bool = False) -> float:
    """Root mean square headline error of a twin on some rows of a recording, driven by the command.

    The recording has all that came before these rows. With `favour` gains and offsets of the predicted
    columns are fitted to them first.
    """
    seen, measured, _ = paths(twin, recording, rows)
    if favour:
        ground = np.concatenate([seen, np.ones((len(seen), 1))], axis=1)
        seen = ground @ np.linalg.lstsq(ground, measured, rcond=None)[0]
    return root_mean(((measured - seen) ** 2).sum(axis=1))


def paths(twin: Twin, recording: Recording, rows: slice) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Headline columns (n, k) predicted and measured in some rows, and their names; see `error_of`."""
    data = read(recording, twin)
    seen, measured = predict(twin, data)[0][rows], data.measured[rows, : data.counted]
    return seen, measured, tuple(data.columns[: data.counted])


def unlike_request(
    twin: Twin,
    recording: Recording,
    rows: slice,
    usual: Mapping[str, float],
    requested: Mapping[str, float],
    ask_below: float,
) -> str:
    """What the finger looks like instead of what was asked for, a sentence; empty where it agrees.

    An error up to `ask_below` agrees. A twin that was not fitted to such a change does not decide.
    """
    error = error_of(twin, recording, rows)
    if error <= ask_below:
        return ""
    others: dict[str, dict[str, float]] = {}
    if "gravity" in twin.effects and any(usual.get(g) != requested.get(g) for g in GRAVITY):
        others["the base had not been turned"] = {g: usual[g] for g in GRAVITY}
    weight = requested.get("payload_g", 0.0)
    if "payload" in twin.effects and weight:
        others |= {f"{s * weight:.0f} g hung at its tip": {"payload_g": s * weight} for s in SHARES}
    errors = {}
    for text, columns in others.items():
        samples = recording.samples.copy()
        for name, value in columns.items():
            samples.loc[samples.index[rows], name] = value
        errors[text] = error_of(twin, replace(recording, samples=samples), rows)
    best = min(errors, key=lambda k: errors[k], default="")
    return f"The finger moved as if {best}." if best and errors[best] < CLEARLY * error else ""


NEEDED = 1.2  # a law is confirmed if the best model without it predicted at least this factor worse
DOUBT = 0.1  # probability that an unconfirmed law is not there, when the next program is chosen
GIVE_UP = 4  # programs in a row, predicted badly and no better, after which it ends
FALLS = 0.9  # of the error over noise: what stays above has not fallen


@one_thread
def learn(
    twin: Twin,
    bench: Bench,
    out: str | Path,
    *,
    budget_s: float = 900.0,
    program_s: float = 60.0,
    seed: int = 0,
    jobs: int = 0,
    hands: Hands = NO_HANDS,
    progress: Callable[[str, int, int], None] | None = None,
    on_round: Callable[[Round], None] = lambda r: None,
) -> Learning:
    """Measures, searches again on everything, and chooses the next program, until it is known or time is up.

    What was measured in `out` is stored: a call with the same folder continues after it.

    Args:
        twin: of the device; not changed.
        bench: that follows programs.
        out: folder of programs, recordings and the learnt twin.
        budget_s: of the programs together.
        program_s: length of a program of the common kinds.
        seed: seed of the data split; of the stand-in's noise, too.
        jobs: number of threads of the search; 0 for all cores.
        hands: what a person may change between programs.
        progress: called with a text, the steps done and all of them.
        on_round: called after each round.

    Raises:
        InputError: the budget is too small for the first program, twin and bench differ in their chambers,
            the folder holds rounds of another twin, the bench's recording cannot be used, or a hand did twice
            what was not asked for.
        HardwareFault: as the bench raises it; finished rounds are stored.
    """
    out = Path(out)
    limits = Limits(*bench.range_kpa, bench.hz, budget_s, program_s)
    same_chambers(twin, limits.chambers)
    first_s = first_program(limits)[0][-1]
    if not first_s <= budget_s:
        both = f"The first program takes {first_s:.0f} s and the budget is {budget_s:g} s"
        raise InputError(f"{both}; give budget_min={math.ceil(first_s / 30)} or more.")
    length_mm = getattr(bench, "length_mm", None)
    if length_mm is not None and not same_length(length_mm, twin):
        standin = isinstance(bench, StandinBench)
        what = "The simulated finger that stands in for a real one" if standin else "The device on the bench"
        remedy = f"give a twin of that device (`pneutac new --length_mm={length_mm:g}`)"
        remedy += ", or your own bench (--bench=measure --measure=FILE)" * standin
        raise InputError(f"{what} is {length_mm:g} mm long and the twin's {twin.length_mm:g} mm; {remedy}.")
    rounds = Rounds(out, twin, bench, seed, jobs, progress, hands)
    while True:
        left_s = budget_s - sum(r.seconds for r in rounds.done)
        choice, ended = rounds.next(replace(limits, seconds=left_s))
        if ended:
            twin = Twin.load(out / "twin")
            return Learning(twin=twin, rounds=tuple(rounds.done), ended=ended, folder=out)
        on_round(rounds.drive(choice))


class Rounds:
    """The rounds in a folder: `round_K` with `program.csv`, `recording`, `diagnosis`, last `round.json`."""

    def __init__(self, out: Path, twin: Twin, bench: Bench, seed: int, jobs: int, progress, hands=NO_HANDS):
        self._out, self._bench, self._hands = out, bench, hands
        self._how = {"seed": seed, "jobs": jobs, "progress": progress}
        self._base = twin
        given = out / "given"
        if not (given / "twin.yaml").is_file():
            twin.copy().save(given)
        elif _body(Twin.load(given, calibrated=False)) != _body(twin):
            raise InputError(f"{out} holds rounds of another twin; give another --out.")
        if not (out / "twin" / "twin.yaml").is_file():
            replace(twin.copy(), folder=None).save(out / "twin")
        self.done: list[Round] = []
        while (file := self._folder(len(self.done)) / "round.json").is_file():
            self.done.append(Round(**read_json(file)))
        self._recordings = [Recording.load(self._folder(r.number) / "recording") for r in self.done]

    def _folder(self, number: int) -> Path:
        return self._out / f"round_{number}"

    @property
    def _candidates(self) -> list[Candidate]:
        return load_candidates(self._folder(self.done[-1].number) / "diagnosis")

    def next(self, limits: Limits) -> tuple[Choice | None, str]:
        """The next program, and why there is none; an empty reason where there is one."""
        if not self.done:
            t, p = first_program(limits)
            return Choice("first", "first", t, p, 0.0, 0.0, 1.0, (), conditions=self._hands.usual), ""
        hands = set(self._hands.changes) - {r.hand for r in self.done}  # each is asked once before the end
        reason = self._known()
        if limits.seconds < limits.length_s / 2:
            return None, reason or "the budget is used up"
        if reason and not hands:
            return None, reason
        try:
            ranked = choices(self._joined(), self._rivals(), self.done[-1].noise, limits, self._hands)
        except InputError as e:
            return None, f"no program is left ({str(e).rstrip('.')})"
        by_hand = [c for c in ranked if c.hand in hands]
        kinds = {r.kind for r in self.done}
        if self.done[-1].unconfirmed or not self.done[-1].selected:  # a law is confirmed by another kind
            ranked = [c for c in ranked if c.kind not in kinds] or ranked
        if ranked[0].tells_little:
            reason = reason or "no program within the limits would add information"
        if by_hand and (reason or limits.seconds < (len(hands) + 1) * limits.length_s):
            return by_hand[0], ""
        return ranked[0], reason

    def _joined(self, *newest: tuple[Recording, float | None]) -> Recording:
        pairs = [*zip(self._recordings, (r.pause_s for r in self.done), strict=True), *newest]
        return joined(*zip(*pairs, strict=True))

    def _rivals(self) -> list[Candidate]:
        """The candidates; one without each law that is not confirmed is at least as likely as `DOUBT`."""
        candidates = self._candidates
        best = candidates[0]
        for e in (e for e in self.done[-1].unconfirmed if e in best.terms):
            lacking = [i for i, c in enumerate(candidates[:-1]) if family(e) not in _families(c)]
            if not lacking:
                rest = tuple(t for t in best.terms if t != e)
                candidates.insert(-1, Candidate(best.twin.without(e), rest, DOUBT))
                continue
            likely = max(lacking, key=lambda i: candidates[i].probability)
            candidates[likely].probability = max(candidates[likely].probability, DOUBT)
        return candidates

    def _known(self) -> str:
        last, two = self.done[-1], self.done[-2:]
        if last.suffices and last.foreseen:
            if not last.unconfirmed:
                return "all that was found predicted a program that it had not seen"
            if all(r.foreseen for r in two) and len({r.kind for r in two}) == 2:
                return "two programs of other kinds in a row were predicted to within the noise"
        ratios = [r.predicted_error / r.noise for r in self.done[1:]][-GIVE_UP:]
        if len(ratios) == GIVE_UP and min(ratios) > CONFIRMS and ratios[-1] > FALLS * ratios[0]:
            return f"{GIVE_UP} programs in a row were predicted no better, so some physics is in no model"
        return ""

    def drive(self, choice: Choice) -> Round:
        """Measures, tests the prediction, searches again on all recordings, and saves."""
        folder = self._folder(len(self.done))
        entry = self._measured(folder, choice)
        recording = same_body(self._base, Recording.load(folder / "recording"), "learn")
        everything = self._joined((recording, entry["pause_s"]))
        newest = slice(len(everything) - len(recording), None)
        predicted_ahead = self._predicted_ahead(folder, everything, newest)
        found = diagnose(self._base, everything, **self._how)
        found.save(folder / "diagnosis")
        self._recordings.append(recording)
        r = self._round_of(entry, found, predicted_ahead)
        names = ", ".join(r.selected) or "nothing"
        history, given = (Twin.load(self._out / name, calibrated=False).history for name in ("twin", "given"))
        errors = {k: found.after[k] for k in ("train", "heldout")} | {"unit": r.unit}
        if len(history) - len(given) == len(self.done):  # else this round was killed just after it saved
            twin = replace(found.twin, history=history)
            twin.save_version(self._out / "twin", f"learnt {names}", str(folder / "recording"), errors)
        write_json(folder / "round.json", asdict(r))
        self.done.append(r)
        return r

    def _measured(self, folder: Path, choice: Choice) -> dict:
        """Drives a program unless that was done before a kill; what was driven, as fields of `Round`."""
        file = folder / "measured.json"
        if not file.is_file():
            before = self._hands.changes.get(self.done[-1].hand if self.done else "", self._hands.usual)
            for sentence in instructions(before, choice.conditions):
                self._hands.ask(sentence)
            if wrong := self._driven(folder, choice):
                for sentence in instructions(self._hands.usual, choice.conditions):
                    self._hands.ask(f"{wrong} {sentence}")
                if wrong := self._driven(folder, choice):
                    raise InputError(f"{wrong} Twice; weigh what hangs there, and start again after it.")
            entry = {"program": choice.name, "kind": choice.kind, "seconds": choice.seconds}
            write_json(file, entry | {"pause_s": self._bench.pause_s, "hand": choice.hand})
        return read_json(file)

    def _driven(self, folder: Path, choice: Choice) -> str:
        """Drives a program; what a hand did instead of what was asked, empty where that is not seen."""
        shutil.rmtree(folder, ignore_errors=True)
        save_table(folder / "program.csv", program_columns(choice))
        self._bench.follow(folder / "program.csv", folder / "recording", len(self.done))
        if not choice.hand:
            return ""
        recording = same_body(self._base, Recording.load(folder / "recording"), "learn")
        everything = self._joined((recording, self._bench.pause_s))
        rows, least = slice(len(everything) - len(recording), None), CONFIRMS * self.done[-1].noise
        asked = self._hands.usual, choice.conditions
        return unlike_request(self._candidates[0].twin, everything, rows, *asked, least)

    def _predicted_ahead(self, folder: Path, everything: Recording, rows: slice) -> dict:
        """Fields of `Round` on how well the newest rows were predicted; writes the paths into `folder`."""
        if not self.done:
            return {"predicted_error": None, "bare_error": None, "without": {}}
        candidates = self._candidates
        best, terms = candidates[0].twin, candidates[0].terms
        seen, measured, names = paths(best, everything, rows)
        columns = ["time_s", *everything.pressure_columns]
        table = everything.samples.iloc[rows][columns].reset_index(drop=True)
        for i, name in enumerate(names):
            table[f"{name} predicted"], table[f"{name} measured"] = seen[:, i], measured[:, i]
        save_table(folder / PREDICTED, table)
        errors = [error_of(c.twin, everything, rows) for c in candidates]

        def lacking(effect: str) -> float:
            """The least error without the effect's kind of physics, of it dropped or of another candidate."""
            dropped = error_of(best.without(effect), everything, rows, favour=True)
            pairs = zip(errors, candidates, strict=True)
            return min(dropped, *(error for error, c in pairs if family(effect) not in _families(c)))

        without = {e: lacking(e) for e in terms}
        return {"predicted_error": errors[0], "bare_error": errors[-1], "without": without}

    def _round_of(self, entry: dict, found: Diagnosis, predicted_ahead: dict) -> Round:
        noise = found.study.noise.needed(found.study.recording.folder)
        needed_by, proven = {}, set()
        if self.done:
            needed_by = {family(e): k for e, k in self.done[-1].needed_by.items()}
            proven = {family(e) for e in self.done[-1].confirmed_by}
            error = predicted_ahead["predicted_error"]
            another = entry["kind"] not in {r.kind for r in self.done}
            if another and error <= CONFIRMS * noise:
                needed = [e for e, worse in predicted_ahead["without"].items() if worse > NEEDED * error]
                needed_by = {family(e): len(self.done) for e in needed} | needed_by
        r = Round(
            number=len(self.done),
            **entry,
            unit=found.study.unit,
            noise=noise,
            **predicted_ahead,
            error=found.after["heldout"],
            verdict=found.verdict,
            selected=list(found.selected),
            sentence=found.sentence,
            probabilities={" + ".join(c.terms): c.probability for c in found.outcome.contenders},
            likely_right=found.outcome.likely_right,
            needed_by={e: needed_by[family(e)] for e in found.selected if family(e) in needed_by},
        )
        if r.refutes:
            return replace(r, needed_by={}, confirmed_by={})
        confirmed = {e: k for e, k in r.needed_by.items() if r.suffices or family(e) in proven}
        return replace(r, confirmed_by=confirmed)


def _families(candidate: Candidate) -> set[str]:
    return {family(e) for e in candidate.terms}


def _body(twin: Twin) -> tuple:
    return twin.device, twin.length_mm, twin.parameters, twin.effects


@dataclass
class LearnConfig:
    """Options of `pneutac learn`."""

    described_by: ClassVar = learn
    resumed_by: ClassVar = "given"

    twin: Path  # folder of the finger's or arm's twin, which is not changed
    # folder of programs, recordings and the learnt twin; a call with a folder that holds rounds continues
    # after them
    out: Path
    bench: str = "standin"  # `standin`, what stands in for a real finger or arm, or `measure`, your bench
    measure: Path | None = None  # YAML file of `pneutac measure` for your bench, without `program` and `out`
    # what a person may be asked to change: `none`, or `flip` (turn the base over), `payload` (hang a weight
    # at the tip) and `warm`, with commas; the stand-in does the first two by itself
    hands: str = "none"
    payload_g: float = 20.0  # weight that can be hung
    warm_c: float = 35.0  # to which the finger can be warmed
    budget_min: float = 15.0  # minutes of programs, together
    program_s: float = 60.0
    seed: int = 0
    jobs: int = 0

    def __post_init__(self):
        check_bench(self.bench, self.measure)
        refuse_unused(self)
        check_least(5, program_s=self.program_s)
        check_least(1, payload_g=self.payload_g)


def command(cfg: LearnConfig, terminal: Terminal) -> None:
    from lerobot_robot_pneutac.hardware.parts import HardwareFault  # LeRobot, which the library does not need

    twin = Twin.load(cfg.twin)
    bench, usual = make_bench(cfg.measure, cfg.out, cfg.seed, twin.device)

    def ask(sentence: str) -> None:
        if cfg.measure is None:
            return
        try:
            terminal.console.input(f"[yellow]{sentence}[/] Then press Enter: ")
        except EOFError as e:
            raise InputError(f"{sentence} There is no answer; give --hands=none, or a terminal.") from e

    def show_round(r: Round) -> None:
        predicted = "" if r.predicted_error is None else f", predicted to {r.predicted_error:.3g}"
        error = f"{r.error:.3g} {r.unit}"
        found = listed(map(called, r.selected)) or "nothing"
        program = f"{r.program} ({r.seconds:.0f} s){predicted}"
        terminal.say(f"round {r.number}, {program}: {error} with {found}, {r.verdict}")

    how = keywords(cfg, learn) | {"hands": Hands.of(named(cfg.hands), usual, cfg.payload_g, cfg.warm_c, ask)}
    how |= {"budget_s": 60 * cfg.budget_min, "on_round": show_round}
    try:
        result = terminal.run(learn, twin, bench, cfg.out, **how)
    except HardwareFault as e:
        raise InputError(f"{e} Finished rounds are stored; the same command continues after them.") from e
    terminal.finish(result, cfg.out)
