"""`pneutac benchmark diagnosis`: blind test of the diagnosis on recordings with hidden effects.

The hidden effects are written in other mathematical forms than the library's, and the answer lies in a file
of its own that is opened only after the diagnosis of the recording was written.
"""

import json
import multiprocessing
import os
import signal
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from lerobot_pneutac.diagnosis.engine import THREADS, cores
from pneutac_sim.errors import InputError

STRENGTHS = (1.0, 0.5, 0.2)
PAIRS = (
    ("creep", "hysteresis"), ("creep", "gravity"), ("creep", "thermal"), ("stiffening", "creep"),
    ("hysteresis", "gravity"), ("stiffening", "thermal"), ("valve_lag", "creep"), ("leak", "hysteresis"),
    ("dead_time", "gravity"), ("friction", "thermal"),
)  # fmt: skip
NONE = 40


@dataclass
class BenchmarkDiagnosisConfig:
    """Options of `pneutac benchmark diagnosis`.

    Attributes:
        out: folder of the table; finished cases in it are not repeated.
        fast: one seed, full strength and four-minute recordings only.
        seeds: recordings of each effect and strength.
        first_seed: of the first recording; another one makes another, equally blind test.
        minutes: length of each recording.
        jobs: processes; 0 for all cores.
    """

    out: Path = Path("outputs/benchmark_diagnosis")
    fast: bool = False
    seeds: int = 5
    first_seed: int = 0
    minutes: float = 10.0
    jobs: int = 0

    def __post_init__(self):
        if self.seeds < 1 or self.jobs < 0 or not 1 <= self.minutes <= 60:
            raise InputError("--seeds must be 1 or more, --jobs 0 or more, --minutes 1 to 60.")
        if self.fast:
            self.seeds, self.minutes = 1, min(self.minutes, 4.0)


@dataclass(frozen=True)
class DiagnosisCase:
    """One blind recording.

    Attributes:
        kind: `effect`, `pair`, `none` or `unknown`.
        effects: hidden names, joined by commas.
        strength: see the generator.
        seed: of everything random.
        minutes: of the recording.
    """

    kind: str
    effects: str
    strength: float
    seed: int
    minutes: float

    @property
    def key(self) -> str:
        """File name of its answer."""
        return (
            f"{self.kind}_{self.effects.replace(',', '+')}_{self.strength:g}_{self.seed}_{self.minutes:g}min"
        )


def cases(cfg: BenchmarkDiagnosisConfig) -> list[DiagnosisCase]:
    """All recordings of the benchmark."""
    from pneutac_datasets.generate.hidden.generate import disturbance_names, effect_names

    strengths = STRENGTHS[:1] if cfg.fast else STRENGTHS
    nones = 3 if cfg.fast else NONE
    m, made = cfg.minutes, []
    for i in range(cfg.seeds):  # a seed's cases come together, so that a stopped run is a smaller benchmark
        seed = cfg.first_seed + i
        made += [DiagnosisCase("effect", e, s, seed, m) for s in strengths for e in effect_names()]
        made += [DiagnosisCase("unknown", e, 1.0, seed, m) for e in disturbance_names()]
        made += [
            DiagnosisCase("pair", ",".join(p), 1.0, seed, m) for p in PAIRS[: 3 if cfg.fast else 10] if i < 2
        ]
        share = range(i * nones // cfg.seeds, (i + 1) * nones // cfg.seeds)
        made += [DiagnosisCase("none", "none", 1.0, cfg.first_seed + 100 + k, m) for k in share]
    return made


def benchmark_diagnosis(cfg: BenchmarkDiagnosisConfig) -> None:
    """Runs what is not there yet, then prints and writes the table."""
    folder = cfg.out / "cases"
    folder.mkdir(parents=True, exist_ok=True)
    todo = [c for c in cases(cfg) if not (folder / f"{c.key}.json").is_file()]
    console = Console()
    console.print(f"{len(cases(cfg))} recordings, {len(todo)} to do; Ctrl-C stops, the same command goes on")
    solve_cases(todo, folder, cfg.jobs or cores(), console)
    from lerobot_pneutac.benchmarks.diagnosis.table import write_table

    answers = [json.loads((folder / f"{c.key}.json").read_text()) for c in cases(cfg)]
    write_table(answers, cfg.out, console)


def solve_cases(todo: list[DiagnosisCase], folder: Path, jobs: int, console: Console) -> None:
    """Diagnoses all cases, each in one process."""
    if not todo:
        return
    os.environ.update({k: os.environ.get(k, "1") for k in THREADS})
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _ignore_interrupt)
    try:
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task("diagnoses", total=len(todo))
            for future in as_completed([pool.submit(solve, c, folder) for c in todo]):
                future.result()
                bar.advance(task)
    except BaseException:
        for p in list(pool._processes.values()):
            p.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def solve(case: DiagnosisCase, folder: Path) -> None:
    """Generates one recording, diagnoses it blindly, then looks up the truth and writes both."""
    from lerobot_pneutac.verbs.diagnose import diagnose
    from pneutac_datasets.generate.hidden.generate import generate
    from pneutac_datasets.recording.recording import Recording
    from pneutac_sim.twin import Twin

    with tempfile.TemporaryDirectory() as tmp:
        hidden = Path(tmp) / "recording"
        generate(case.effects.split(","), hidden, case.seed, case.strength, case.minutes)
        recording = Recording.load(hidden)
        twin = Twin(recording.device, recording.length_mm, recording.spine_joint_positions_mm)
        began = time.perf_counter()
        d = diagnose(twin, recording, jobs=1, seed=case.seed)
        answer = asdict(case) | {
            "verdict": d.verdict,
            "selected": d.selected,
            "rivals": [[r.effect, r.rival] for r in d.outcome.rivals],
            "noise_floor": d.study.noise.value,
            "before": d.before["heldout"],
            "after": d.after["heldout"],
            "reduction": d.reduction[0],
            "error_over_noise": [getattr(d.outcome.evidence, k) for k in ("before", "after", "limit")],
            "seconds": time.perf_counter() - began,
        }
        written = folder / f"{case.key}.json.part"
        written.write_text(json.dumps(answer, indent=1))
        truth = json.loads((Path(tmp) / "truth" / "recording.json").read_text())
        answer["truth"] = {
            "effects": truth["effects"],
            "accepts": [x["accepts"] for x in truth["details"]],
            "misfit": truth["misfit_mm"],
        }
        written.write_text(json.dumps(answer, indent=1))
        written.replace(folder / f"{case.key}.json")
