"""`pneutac benchmark speed`: measures what material points and Gaussian splats cost here."""

import importlib.util
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markdown import Markdown

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.speed.splats import time_splats
from pneutac_benchmarks.tables import markdown
from pneutac_sim.errors import InputError, check_choice, check_least
from pneutac_sim.mpm.body import Body, Material, Spine
from pneutac_sim.mpm.runtime import start
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

SILICONE = Material(3e5, 0.45)
GEL = Material(1e5, 0.46)
DOWN = np.array([9.81, 0.0, 0.0])  # the finger hangs


@dataclass
class BenchmarkSpeedConfig:
    """Options of `pneutac benchmark speed`.

    Attributes:
        device: `auto`, `cpu` or `cuda`.
        repeats: number of times that each is measured; the median counts.
        out: folder for `result.json` and `table.md`.
    """

    device: str = "auto"
    repeats: int = 3
    out: Path | None = None

    def __post_init__(self):
        check_choice("device", self.device, ("auto", "cpu", "cuda"))
        check_least(1, repeats=self.repeats)


def finger(batch: int, device: str, scale: float = 1.0) -> TotalLagrangian:
    """Fingers of 99 x 20 x 22 mm with four joints, 4,050 particles each at scale 1."""
    counts = np.round(np.array([45, 9, 10]) * scale).astype(int)
    h = 2.2e-3 / scale
    body = Body.box("finger", counts, h, SILICONE, clamp="x-")
    length = counts[0] * h
    joints = tuple(length * (np.arange(4) + 0.5) / 4)
    spine = Spine(joints, length, counts[1] * h / 2, counts[2] * h / 2, 3e-3, stiffness_nm_per_rad=20.0)
    return TotalLagrangian(body, spine, batch, device=device)


def gel(batch: int, device: str) -> TotalLagrangian:
    """DIGIT's gel, 59 x 80 x 13 particles."""
    body = Body.box("gel", (59, 80, 13), 0.26e-3, GEL, clamp="z-")
    return TotalLagrangian(body, batch=batch, device=device)


def press(depth_m: float) -> Loads:
    """A sphere of 3 mm radius in the middle of the gel."""
    return Loads(
        indenter="sphere",
        size_m=np.array([3e-3, 1.0, 1.0]),
        position_m=np.array([7.67e-3, 10.4e-3, 3.38e-3 - depth_m]),
    )


def bent(angle: float, batch: int = 1) -> Loads:
    """All four joints driven to one angle, under gravity."""
    return Loads(q_cmd=np.full((batch, 4), angle), gravity=DOWN)


def timed(work, repeats: int) -> float:
    """Median seconds of `work()`."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def substep_s(solver: TotalLagrangian, loads: Loads, repeats: int, least: int = 100) -> float:
    """Seconds of one substep of the whole batch."""
    solver.apply(loads, damping=100.0)
    solver.step(10)
    solver.nodes()

    def work():
        solver.step(least)
        solver.nodes()

    return timed(work, repeats) / least


def genesis_substep_s(device: str) -> float:
    """Seconds of one substep of Genesis' MPM on a beam of 4,050 particles, in a process of its own."""
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-m",
        "pneutac_benchmarks.speed.genesis_substep",
        device,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    found = [line for line in done.stdout.splitlines() if line.startswith("SUBSTEP ")]
    if not found:
        raise InputError(f"Genesis is installed but did not run: {done.stderr.strip()[-300:]}")
    return float(found[0].split()[1])


def measure(device: str, repeats: int, progress=lambda text: None) -> list[dict]:
    """Rows `work`, `value`, `unit`, `note`."""
    progress("finger: compiling, then from rest to 0.3 rad a joint")
    rows, one = finger_rows(device, repeats)
    on_cpu = one.device == "cpu"
    progress("gel: sphere pressed in by 1.4 mm")
    rows += gel_rows(device, repeats)
    for batch in (16, 64) if on_cpu else (64, 1024, 4096):
        progress(f"{batch} fingers at once")
        many = finger(batch, device)
        rate = batch / substep_s(many, bent(0.3, batch), repeats, 20 if on_cpu else 200)
        note = f"{rate * 4050 / 1e6:.0f} M particle-substeps/s"
        rows.append(row(f"{batch} fingers", rate, "finger-substeps/s", note))
        del many
    for scale in (0.67, 1.0, 1.5, 2.0):
        progress(f"finger at {scale} times the resolution")
        other = finger(1, device, scale)
        work = f"finger substep, {len(other.body.cells):,} particles"
        rows.append(row(work, 1e6 * substep_s(other, bent(0.3), repeats), "us"))
    if importlib.util.find_spec("genesis"):
        progress("the same beam by Genesis")
        rows.append(genesis_row(device, one.device, repeats))
    return rows


def row(work: str, value: float, unit: str, note: str = "") -> dict:
    """A row of the table."""
    return {"work": work, "value": float(value), "unit": unit, "note": note}


def finger_rows(device: str, repeats: int) -> tuple[list[dict], TotalLagrangian]:
    """One finger: compiling, from rest, from the pressure before, one substep; and the finger."""
    one = finger(1, device)
    compiling_s = timed(lambda: solve_equilibrium(one, bent(0.1)), 1)
    found = []
    rest_s = timed(lambda: found.append(solve_equilibrium(one, bent(0.3))), repeats)
    rest = found[-1]
    angles = iter(0.3 + 0.02 * np.arange(1, repeats + 1))
    warm_s = timed(lambda: found.append(solve_equilibrium(one, bent(next(angles)), warm=True)), repeats)
    return [
        row("first finger, with compiling", compiling_s, "s", "seconds later on, from the cache"),
        row("finger equilibrium from rest, 4,050 particles", 1e3 * rest_s, "ms", f"{rest.substeps} substeps"),
        row(
            "finger pressure point, warm start (+0.02 rad)",
            1e3 * warm_s,
            "ms",
            f"{found[-1].substeps} substeps",
        ),
        row("finger substep", 1e6 * substep_s(one, bent(0.3), repeats), "us"),
    ], one


def gel_rows(device: str, repeats: int) -> list[dict]:
    """One gel: compiling, a press, one substep."""
    pad = gel(1, device)
    compiling_s = timed(lambda: solve_equilibrium(pad, press(0.2e-3)), 1)
    found = []
    press_s = timed(lambda: found.append(solve_equilibrium(pad, press(1.4e-3))), repeats)
    note = f"{found[-1].substeps} substeps, penetration {1e6 * found[-1].penetration_m[0]:.1f} um"
    return [
        row("first gel, with compiling", compiling_s, "s"),
        row("gel, 1.4 mm indentation, 61,360 particles", 1e3 * press_s, "ms", note),
        row("gel substep in contact", 1e6 * substep_s(pad, press(1.4e-3), repeats), "us"),
    ]


def genesis_row(device: str, chosen: str, repeats: int) -> dict:
    """The same beam by Genesis and by this solver, on the device that `device` became."""
    from pneutac_benchmarks.speed.genesis_substep import COUNTS, DT, SPACING_M

    beam = TotalLagrangian(Body.box("beam", COUNTS, SPACING_M, SILICONE), device=device)
    ours = substep_s(beam, Loads(gravity=np.array([0.0, 0.0, -1.0])), repeats)
    theirs = genesis_substep_s(chosen)
    note = f"Genesis {1e6 * theirs:.0f} us, ours {1e6 * ours:.0f} us; same spacing, grid, step of {DT:g} s"
    return row("beam substep, Genesis over ours", theirs / ours, "times", note)


def table(rows: list[dict]) -> str:
    """Rows as markdown."""
    cells = [
        (r["work"], f"{r['value']:,{'.3g' if r['value'] < 1e4 else '.0f'}} {r['unit']}", r["note"])
        for r in rows
    ]
    return "\n".join(markdown(("work", "measured", ""), cells)) + "\n"


def benchmark_speed(config: BenchmarkSpeedConfig) -> None:
    """Runs the benchmark."""
    console = Console()
    device = start(config.device)
    with console.status("") as status:
        rows = measure(device, config.repeats, status.update)
    console.print(Markdown(table(rows)))
    splats = time_splats(console)
    if config.out is not None:
        write_result(config.out, {"device": device, "rows": rows, "splats": splats})
        (config.out / "table.md").write_text(table(rows))
        console.print(f"table: {config.out / 'table.md'}", highlight=False)
