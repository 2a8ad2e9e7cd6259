"""`pneutac benchmark diagnosis_speed`: seconds of a diagnosis by samples, chambers and candidates.

Recordings are of independent simulations at 20 Hz. A run, a Jacobian and a control step are of the model
that was found, the least of several, in milliseconds of processor time. To plan again, `learn` diagnoses and
chooses the next program.
"""

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from lerobot_pneutac.diagnosis.design import choices
from lerobot_pneutac.diagnosis.programs import Limits
from lerobot_pneutac.diagnosis.search import Steps
from lerobot_pneutac.reports.page import write_result
from lerobot_pneutac.study import study_of
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import is_law
from pneutac_sim.errors import InputError, check_between
from pneutac_sim.finger import BodyData, Pipeline, PressurePipeline
from pneutac_sim.finger.problem import Bounds, Problem
from pneutac_sim.twin import Twin
from pneutac_truths import generate, write

ROWS = 1700  # that a search fits
EFFECT = "creep_fractional"
HEADS = (
    "device", "samples", "chambers", "candidates", "seconds", "processor seconds", "next program, s", "named",
    "run, ms", "Jacobian, ms", "control step, ms",
)  # fmt: skip


@dataclass
class BenchmarkDiagnosisSpeedConfig:
    """Options of `pneutac benchmark diagnosis_speed`.

    Attributes:
        minutes: lengths of the recordings of one chamber.
        arm_minutes: length of the recording of three chambers; 0 leaves it out.
        seed: of the devices.
        jobs: threads; 0 for all cores.
        out: folder for `result.json` and `table.md`.
    """

    minutes: tuple[float, ...] = (5.0, 10.0, 20.0)
    arm_minutes: float = 10.0
    seed: int = 61
    jobs: int = 0
    out: Path | None = None

    def __post_init__(self):
        check_between(0, 600, arm_minutes=self.arm_minutes)
        if not self.minutes or not all(1 <= m <= 600 for m in self.minutes):
            raise InputError("--minutes must be lengths of 1 to 600.")


def recorded(device: str, minutes: float, seed: int) -> Recording:
    """A recording of a device that creeps, without a pressure gauge."""
    with tempfile.TemporaryDirectory() as folder:
        truth = generate(device, [EFFECT], seed, gauge=False, minutes=minutes)
        return Recording.load(write(truth, Path(folder) / "recording"))


def least_ms(work: Callable[[], object], times: int = 5) -> float:
    """Least processor time of several calls; the first, which may compile, is not counted."""
    work()
    spent = []
    for _ in range(times):
        began = time.process_time()
        work()
        spent.append(time.process_time() - began)
    return 1e3 * min(spent)


def parts_ms(twin: Twin, recording: Recording) -> dict[str, float]:
    """Milliseconds of a run, of a Jacobian at the rows of a search, and of one control step."""
    data = BodyData.of(recording, twin, "command", switch=0.5)
    data = data.thin(np.arange(0, len(data), max(1, len(data) // ROWS)))
    pipeline = Pipeline.of(twin, data.inputs)
    theta, kpa = pipeline.theta(twin), data.inputs.pressure_range_kpa
    bounds, free = Bounds(pipeline, kpa), np.flatnonzero([not p.fixed for p in pipeline.specs])

    def problem() -> Problem:
        return Problem(pipeline, data, np.clip(theta, bounds.lower, bounds.upper), bounds, free)

    v, run = bounds.scaled(theta, free), least_ms(lambda: pipeline.run(data.inputs, theta))
    both = least_ms(lambda: problem().jacobian(v))
    given = {name: float(values[0]) for name, values in data.inputs.columns.items()}
    online = PressurePipeline(twin, given)
    steps = least_ms(lambda: [online.step(0.5 * kpa, 0.05) for _ in range(200)])
    return {"run_ms": run, "jacobian_ms": both - run, "step_ms": steps / 200}


def measured(recording: Recording, laws: bool, cfg: BenchmarkDiagnosisSpeedConfig) -> dict:
    """A row of the table: one diagnosis; without laws, of the library's effects alone."""
    study = study_of(Twin(recording.device, recording.length_mm or 110.0), recording, 0)
    if not laws:
        study.candidates = [c for c in study.candidates if not is_law(c)]
    wall, processor = time.perf_counter(), time.process_time()
    outcome = study.search(cfg.jobs or len(os.sched_getaffinity(0)), Steps(None))
    seconds, diagnosed = time.perf_counter() - wall, time.process_time()
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    limits = Limits(command.min(axis=0), command.max(axis=0))
    choices(recording, outcome.contenders, study.noise.floor, limits)
    return {
        "device": recording.device, "samples": len(recording),
        "chambers": len(recording.pressure_columns), "candidates": len(study.candidates),
        "seconds": seconds, "processor_seconds": diagnosed - processor,
        "next_program_s": time.process_time() - diagnosed,
        "named": [e for e in outcome.after.twin.effects if e in outcome.selected],
    } | parts_ms(outcome.after.twin, recording)  # fmt: skip


def benchmark_diagnosis_speed(cfg: BenchmarkDiagnosisSpeedConfig) -> None:
    """Runs the benchmark; a short diagnosis before it compiles what is not compiled yet."""
    console, rows = Console(), []
    with console.status("compiling"):
        measured(recorded("rod", 1.0, cfg.seed), True, cfg)
    for device, minutes, laws in (
        *(("rod", m, True) for m in cfg.minutes),
        ("rod", cfg.minutes[0], False),
        *([("arm", cfg.arm_minutes, True)] if cfg.arm_minutes else []),
    ):
        with console.status(f"{device}, {minutes:g} minutes"):
            rows.append(measured(recorded(device, minutes, cfg.seed), laws, cfg))
    cells = [
        (
            r["device"], f"{r['samples']:,}", str(r["chambers"]), str(r["candidates"]),
            f"{r['seconds']:.1f}", f"{r['processor_seconds']:.1f}", f"{r['next_program_s']:.1f}",
            ", ".join(r["named"]) or "nothing",
            f"{r['run_ms']:.2f}", f"{r['jacobian_ms']:.1f}", f"{r['step_ms']:.3f}",
        )
        for r in rows
    ]  # fmt: skip
    console.print(terminal("diagnosis", HEADS, cells))
    if cfg.out is not None:
        write_result(cfg.out, {"rows": rows})
        (cfg.out / "table.md").write_text("\n".join(markdown(HEADS, cells)) + "\n")
