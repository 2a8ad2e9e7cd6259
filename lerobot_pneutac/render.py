"""`pneutac render`: pictures and a film of a finger, arm or gel of material points under load."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from lerobot_pneutac import particle_picture as draw
from lerobot_pneutac.options import parse_options
from lerobot_pneutac.render_options import FPS, RenderConfig, deepest_press, filled
from lerobot_pneutac.report import Report, write_result
from pneutac_sim.errors import InputError
from pneutac_sim.finger.inputs import CHAMBERS
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

PRESS_FRAMES = 8  # depths on the way down
BODY_STRAIN, GEL_STRAIN = 0.15, 0.8  # of the warmest colour
SIZE = {"cube": "side", "edge": "side"}  # what size_mm is; of the round indenters the radius
# What helps where no equilibrium is found.
BODY_REMEDY = "give lower --pressure_kpa, more --particles, or a thicker mesh where the twin has its own"
GEL_REMEDY = "press less deep with --depth_mm, or give a larger indenter with --size_mm"


@dataclass
class Frame:
    """One picture of the film; where `row` is a line of the table, the picture is a still too."""

    picture: np.ndarray
    row: dict | None = None


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config = parse_options(RenderConfig, argv)
    twin = Twin.load(config.twin)
    config = filled(config, twin)
    frames, count = _gel(twin, config) if twin.device == "gel" else _body(twin, config)
    from pneutac_sim.mpm.solve import MpmDiverged

    try:
        render(twin.device, frames, count, config.out)
    except MpmDiverged as e:
        remedy = GEL_REMEDY if twin.device == "gel" else BODY_REMEDY
        raise InputError(f"{e.finding}; {remedy}.") from e


def render(device: str, frames: Iterator[Frame], count: int, out: Path) -> dict:
    """Draws frames; what is finished is kept where it is interrupted.

    Args:
        device: of the twin.
        frames: made one by one.
        count: how many there will be.
        out: folder to write to.

    Returns:
        what `result.json` holds.
    """
    console, out = Console(), Path(out)
    out.mkdir(parents=True, exist_ok=True)
    pictures: list[np.ndarray] = []
    rows: list[dict] = []
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    start = time.perf_counter()
    try:
        with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
            task = bar.add_task("building the body", total=count)
            for frame in frames:
                pictures.append(frame.picture)
                if frame.row is not None:
                    name = f"{device}_{len(rows) + 1}.png"
                    Image.fromarray(frame.picture).save(out / name)
                    rows.append(frame.row | {"picture": name})
                bar.update(task, advance=1, description="bringing it to rest")
    finally:
        result = _write(device, pictures, rows, count, time.perf_counter() - start, out)
        _show(console, result, out)
    return result


def _write(device: str, pictures: list, rows: list[dict], count: int, seconds: float, out: Path) -> dict:
    result = {
        "device": device,
        "complete": len(pictures) == count,
        "frames": len(pictures),
        "seconds": seconds,
        "film": None,
        "stills": rows,
    }
    if pictures:
        from lerobot.utils.io_utils import write_video

        write_video(out / "film.mp4", pictures + [pictures[-1]] * FPS, FPS)
        result["film"] = "film.mp4"
        report = Report(f"A {device} of material points")
        what = " Right: the tactile image, by Gaussian splats on the particles." if device == "gel" else ""
        report.lead(f"Colour is the largest stretch of the material, from calm to warm.{what}")
        report.video(out / "film.mp4")
        report.table(rows)
        for row in rows:
            report.image(np.asarray(Image.open(out / row["picture"])), row["picture"])
        report.write(out)
    write_result(out, result)
    return result


def _show(console: Console, result: dict, out: Path) -> None:
    if result["stills"]:
        table = Table()
        for name in result["stills"][0]:
            table.add_column(name.replace("_", " "), justify="right")
        for row in result["stills"]:
            table.add_row(*(f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()))
        console.print(table)
    end = "" if result["complete"] else f" (stopped after {result['frames']} pictures of the film)"
    console.print(f"{out / (result['film'] or 'result.json')}{end}", highlight=False)


# ---------------------------------------------------------------- finger and arm


def _body(twin: Twin, config: RenderConfig) -> tuple[Iterator[Frame], int]:
    chambers = CHAMBERS[twin.device]
    if len(config.pressure_kpa) % chambers:
        raise InputError(
            f"--pressure_kpa has {len(config.pressure_kpa)} numbers; an arm takes three for each pose."
        )
    points = np.reshape(config.pressure_kpa, (-1, chambers))
    each = max(2, round(config.seconds * FPS))
    share = np.minimum(np.arange(1, each + 1) / (each // 2), 1.0)[:, None]
    program = np.concatenate(
        [points[:1]] + [a + share * (b - a) for a, b in zip(points[:-1], points[1:], strict=True)]
    )
    return _body_frames(twin, config, program, each), len(program)


def _body_frames(twin: Twin, config: RenderConfig, program: np.ndarray, each: int) -> Iterator[Frame]:
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.mpm.total_lagrangian import Loads

    q_cmd = devices.joint_targets(twin, program, np.arange(len(program)) / FPS, config.conditions)
    make = devices.finger if twin.device == "finger" else devices.arm
    solver = make(twin, particles=config.particles, device=config.device)
    spent = 0.0
    for k, (pressure, q) in enumerate(zip(program, q_cmd, strict=True)):
        start = time.perf_counter()
        rest = solve_equilibrium(solver, Loads(q_cmd=q[None]), warm=k > 0)
        spent += time.perf_counter() - start
        spine = devices.spine_points(solver, rest.q)[0]
        tip = 1e3 * spine[-1]
        named = ", ".join(f"{p:.1f}" for p in pressure)
        picture = draw.body_picture(
            rest.positions[0],
            rest.gradients[0],
            spine,
            1e-3 * twin.length_mm,
            solver.body.spacing_m,
            f"{named} kPa   tip x {tip[0]:.1f}  y {tip[1]:.1f}  z {tip[2]:.1f} mm",
            BODY_STRAIN,
            turns=(24.0,) if twin.device == "finger" else (24.0, -66.0),  # an arm bends out of the plane
        )
        row = None
        if k % each == 0:
            row = {
                "pressure_kpa": named if len(pressure) > 1 else float(pressure[0]),
                "tip_x_mm": float(tip[0]),
                "tip_y_mm": float(tip[1]),
                "tip_z_mm": float(tip[2]),
                "seconds": spent,
            }
            spent = 0.0
        yield Frame(picture, row)


# ---------------------------------------------------------------- gel


def _gel(twin: Twin, config: RenderConfig) -> tuple[Iterator[Frame], int]:
    return _gel_frames(twin, config, deepest_press(config, GelModel.from_twin(twin))), PRESS_FRAMES


def _gel_frames(twin: Twin, config: RenderConfig, press: Press) -> Iterator[Frame]:
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.splat.gel import SplatSensor

    solver = devices.gel(twin, device=config.device)
    model = GelModel.from_twin(twin)
    window, sensor = model.window_mm, SplatSensor(model)
    cells = solver.body.cells
    named = f"{press.indenter}, {SIZE.get(press.indenter, 'radius')} {press.size_mm:g} mm"
    spent = 0.0
    for k in range(PRESS_FRAMES):
        depth = config.depth_mm * (k + 1) / PRESS_FRAMES
        start = time.perf_counter()
        rest = solve_equilibrium(solver, devices.press_loads(replace(press, depth_mm=depth)), warm=k > 0)
        spent += time.perf_counter() - start
        moved = devices.surface_displacement(solver, window)[0]
        row = np.argmin(np.abs(solver.body.positions[:, 1] - 1e-3 * press.y_mm))
        cut = cells[:, 1] == cells[row, 1]
        force = float(np.linalg.norm(rest.contact_force[0]))
        picture = draw.gel_picture(
            moved,
            1e3 * rest.positions[0, cut],
            draw.strain(rest.gradients[0, cut]),
            1e3 * solver.body.spacing_m,
            window,
            config.depth_mm,
            GEL_STRAIN,
            f"{named}   depth {depth:.2f} mm   force {force:.2f} N",
        )
        picture = draw.beside(picture, sensor.image(moved))
        last = k == PRESS_FRAMES - 1
        values = {
            "depth_mm": depth,
            "face_mm": float(moved.max()),
            "force_n": force,
            "penetration_um": float(1e6 * rest.penetration_m[0]),
            "seconds": spent,
        }
        yield Frame(picture, values if last or k == PRESS_FRAMES // 2 - 1 else None)
