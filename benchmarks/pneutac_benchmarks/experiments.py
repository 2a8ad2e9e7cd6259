"""`pneutac benchmark experiments`: minutes of recording until it is known what a foreign device does.

Ours, programs at random, and a full standard session, on devices that share nothing with the twin. A device
is known at the first moment from which on the headline names its physics and another day's error is within
1.5 times the noise (`diagnosis.rules`). A law that was confirmed and is none of the device's is a wrong one.
"""

import json
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from lerobot_pneutac.cli.terminal import progress_bar
from lerobot_pneutac.diagnosis.design import Choice, Limits
from lerobot_pneutac.diagnosis.programs import common_programs
from lerobot_pneutac.verbs.diagnose import diagnose
from lerobot_pneutac.verbs.learn import Rounds, error_of
from pneutac_benchmarks.diagnosis.rules import BASE, COUNTS, COUNTS_AS_NEAR, counts, names_right
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_datasets.generate.finger import TruthBench
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, check_between, check_choice
from pneutac_sim.executor import ExecutorOptions, run_pieces
from pneutac_sim.files import claim, write_json, write_text
from pneutac_sim.twin import Twin
from pneutac_truths import EFFECTS, generate, write

# Ten of which the grammar has a form, then ten of which it has none.
LAWS = (
    "creep_fractional", "hysteresis_preisach", "fill_orifice", "dead_time", "unfolding", "valve_deadband",
    "mullins", "seam_snap", "self_heating", "balloon_softening",
)  # fmt: skip
NO_FORM = (
    "hunting", "coarse_steps", "stalls", "humidity_swelling", "regulator_zero", "clock_jitter", "marker_slip",
    "mount_knock", "tracker_freezes", "tracker_outliers",
)  # fmt: skip
DEVICES = {"rod": ("finger", "a rod"), "arm": ("arm", "an arm")}  # of the truths, as a twin has it
STRATEGIES = ("ours", "random", "standard")
PAUSE_S = 120.0
DRAWN = ("temperature_c",)  # logged by the draw of a recording, not by every one
OF_BASE = ("base_tilt", "elongation", "gravity", "payload")


@dataclass
class BenchmarkExperimentsConfig(ExecutorOptions):
    """Options of `pneutac benchmark experiments`.

    Attributes:
        out: folder of the table; finished devices in it are not repeated.
        effects: names of truths, with commas; where left out, ten with a form in the grammar and ten without.
        seed: of the devices.
        device: `rod`, of one chamber, or `arm`, of three.
        budget_min: minutes of programs, together.
    """

    out: Path = Path("outputs/benchmark_experiments")
    effects: tuple[str, ...] = ()
    seed: int = 41
    device: str = "rod"
    budget_min: float = 10.0

    def __post_init__(self):
        self.check_executor()
        check_between(2, 600, budget_min=self.budget_min)
        check_choice("device", self.device, tuple(DEVICES))
        for name in self.effects:
            if name not in EFFECTS or self.device not in EFFECTS[name].devices:
                raise InputError(
                    f"effects: there is no truth '{name}' of {DEVICES[self.device][1]}; give some of "
                    f"{', '.join(LAWS + NO_FORM)}."
                )


def benchmark_experiments(cfg: BenchmarkExperimentsConfig) -> None:
    """Runs what is not there yet, then prints and writes the table."""
    names = cfg.effects or LAWS + NO_FORM
    cases = [(name, s) for s in STRATEGIES for name in names]  # the longest first
    files = [cfg.out / "cases" / f"{n}_{s}.json" for n, s in cases]
    console = Console()
    claim(cfg.out / "run.json", {n: getattr(cfg, n) for n in ("seed", "device", "budget_min")})
    missing = sum(not file.is_file() for file in files)
    console.print(f"{len(cases)} cases, {missing} to do; Ctrl-C stops, the same command goes on")
    with progress_bar(Console(stderr=True)) as progress:
        run_pieces(partial(_solve, cases, files, cfg), files, cfg.out / "logs", cfg, progress, "experiments")
    _write_table([json.loads(file.read_text()) for file in files], cfg.out, console)


def _solve(
    cases: list[tuple[str, str]], files: list[Path], cfg: BenchmarkExperimentsConfig, number: int
) -> None:
    name, strategy = cases[number]
    with tempfile.TemporaryDirectory() as tmp:
        other_day = generate(
            cfg.device, [name], cfg.seed, day=2, minutes=4.0, state_pauses=True, log_sent=True
        )
        judge, floor = check(Recording.load(write(other_day, Path(tmp) / "2")))[0], other_day.noise_floor
        twin = Twin(DEVICES[cfg.device][0], judge.length_mm or 110.0)
        run = _standard if strategy == "standard" else _rounds
        steps = run(name, strategy, cfg, Path(tmp), twin, judge, floor)
    known = _known_at(name, steps)
    answer = {"effect": name, "strategy": strategy, "known_min": known, "steps": steps}
    write_json(files[number], answer)


def _standard(name, strategy, cfg, tmp, twin, judge, floor) -> list[dict]:
    """The truth's own session of ten minutes, once."""
    learn = Recording.load(
        write(generate(cfg.device, [name], cfg.seed, day=1, state_pauses=True, log_sent=True), tmp / "1")
    )
    d = diagnose(twin, learn, jobs=1, seed=cfg.seed)
    ratio = error_of(d.twin, judge) / floor
    return [{"min": 10.0, "verdict": d.verdict, "selected": d.selected, "ratio": ratio, "confirmed": []}]


def _rounds(name, strategy, cfg, tmp, twin, judge, floor) -> list[dict]:
    bench, rng = TruthBench((name,), cfg.seed, cfg.device), np.random.default_rng([cfg.seed, len(name)])
    rounds = Rounds(tmp / "rounds", twin, bench, cfg.seed, 1, None)
    steps, spent_s = [], 0.0
    while True:
        limits = Limits(*bench.range_kpa, bench.hz, 60 * cfg.budget_min - spent_s)
        choice, ended = rounds.next(limits)
        if strategy == "random" and rounds.done and not ended:
            programs = list(common_programs(limits))
            label, kind, t, p = programs[rng.integers(len(programs))]
            choice = Choice(label, kind, t, p, 0.0, 0.0, 0.0, ())
        if ended or choice is None:
            return steps
        r = rounds.drive(choice)
        spent_s += r.seconds
        ratio = error_of(Twin.load(tmp / "rounds" / "twin"), judge) / floor
        steps.append(
            {
                "min": spent_s / 60, "verdict": r.verdict, "selected": r.selected, "ratio": ratio,
                "confirmed": list(r.confirmed_by), "probability": max(r.probabilities.values()),
                "program": r.program, "kind": r.kind, "error": r.error, "noise": r.noise,
                "predicted": r.predicted_error, "without": r.without, "likely_right": r.likely_right,
                "rivals": r.probabilities,
            }
        )  # fmt: skip


def _known_at(name: str, steps: list[dict]) -> float | None:
    """Minutes from which on it was known, to the end; None where it was not."""
    physics = [name] if EFFECTS[name].physics else []
    known = [
        names_right(physics, s["verdict"], s["selected"], s["ratio"]) and s["ratio"] <= COUNTS_AS_NEAR
        for s in steps
    ]
    if not known or not known[-1]:
        return None
    first = len(known) - next((i for i, k in enumerate(reversed(known)) if not k), len(known))
    return steps[first]["min"]


def wrong_ones(answer: dict) -> list[str]:
    """Effects that were confirmed in the end and are none of the device's."""
    allowed = [n for n in COUNTS[answer["effect"]] if n != BASE]
    last = answer["steps"][-1]["confirmed"] if answer["steps"] else []
    return [e for e in last if e not in OF_BASE and not counts(e, allowed)]


def _write_table(answers: list[dict], out: Path, console: Console) -> None:
    heads = ["device", *(f"{s}, min" for s in STRATEGIES), "confirmed (ours)", "wrong ones"]
    rows = []
    for name in dict.fromkeys(a["effect"] for a in answers):
        of = {a["strategy"]: a for a in answers if a["effect"] == name}
        minutes = ["-" if of[s]["known_min"] is None else f"{of[s]['known_min']:.1f}" for s in STRATEGIES]
        last = of["ours"]["steps"][-1]
        wrong = ", ".join(wrong_ones(of["ours"]))
        rows.append([name, *minutes, ", ".join(last["confirmed"]) or "-", wrong or "-"])
    write_text(out / "experiments.md", "\n".join(markdown(heads, rows)) + "\n")
    console.print(terminal("Minutes until it is known", heads, rows))
