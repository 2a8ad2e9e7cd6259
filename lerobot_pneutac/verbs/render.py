"""`pneutac render`: pictures and a film of a finger, arm or gel of material points under load."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.rendering import particles as draw
from lerobot_pneutac.rendering.body import STRETCH, Film, Frame, body_film
from lerobot_pneutac.rendering.options import FPS, RenderConfig, deepest_press, filled
from lerobot_pneutac.reports.page import Report, write_result
from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

PRESS_FRAMES = 8  # depths on the way down
GEL_STRAIN = 0.8  # of the warmest colour
SIZE = {"cube": "side", "edge": "side"}  # what size_mm is; of the round indenters the radius
# What helps where no equilibrium is found.
BODY_REMEDY = "give lower --pressure_kpa, more --particles, or a thicker mesh where the twin has its own"
GEL_REMEDY = "press less deep with --depth_mm, or give a larger indenter with --size_mm"


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config = parse_options(RenderConfig, argv)
    twin = Twin.load(config.twin)
    config = filled(config, twin)
    console = Console()
    with console.status("building the body"):
        film = _gel_film(twin, config) if twin.device == "gel" else body_film(twin, config)
    from pneutac_sim.mpm.solve import MpmDiverged

    try:
        render(twin.device, film, config.out)
    except MpmDiverged as e:
        remedy = GEL_REMEDY if twin.device == "gel" else BODY_REMEDY
        raise InputError(f"{e.finding}; {remedy}.") from e


def render(device: str, film: Film, out: Path) -> dict:
    """Draws frames; what is finished is kept where it is interrupted.

    Args:
        device: of the twin.
        film: its frames are made one by one.
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
            task = bar.add_task("bringing it to rest", total=film.count)
            for frame in film.frames:
                pictures.append(frame.picture)
                if frame.row is not None:
                    name = f"{device}_{len(rows) + 1}.png"
                    Image.fromarray(frame.picture).save(out / name)
                    rows.append(frame.row | {"picture": name})
                bar.update(task, advance=1)
    finally:
        result = _write(device, film, pictures, rows, time.perf_counter() - start, out)
        _show(console, result, out)
    return result


def _write(device: str, film: Film, pictures: list, rows: list[dict], seconds: float, out: Path) -> dict:
    result = {
        "device": device,
        "complete": len(pictures) == film.count,
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
        report.lead(film.lead)
        report.video(out / "film.mp4", width=min(960, pictures[0].shape[1]))
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


def _gel_film(twin: Twin, config: RenderConfig) -> Film:
    press = deepest_press(config, GelModel.from_twin(twin))
    lead = f"{STRETCH} Right: the tactile image, by Gaussian splats on the particles."
    return Film(_gel_frames(twin, config, press), PRESS_FRAMES, lead)


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
