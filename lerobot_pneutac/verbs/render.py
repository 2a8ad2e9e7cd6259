"""Pictures and a film of a finger, arm or gel of material points under load."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.rendering.options import FPS, RenderConfig, filled
from lerobot_pneutac.reports.page import Report, write_result
from lerobot_pneutac.verbs.result import Result, about
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.files import write_image
from pneutac_sim.twin import Twin

if TYPE_CHECKING:
    from lerobot_pneutac.rendering.body import Film  # which starts a compiler


@dataclass(frozen=True)
class RenderedFilm(Result):
    """What was drawn."""

    device: str
    complete: bool  # whether the film came to its end
    frames: int
    seconds: float  # that drawing took
    film: str | None  # its file; None where not one picture was finished
    stills: list[dict]  # a row each: load, what was measured, and `picture`, its file

    keys = ("device", "complete", "frames", "seconds", "film", "stills")

    def rows(self) -> list[dict]:
        return self.stills


def make_film(twin: Twin, config: RenderConfig) -> "Film":
    if twin.device == "gel":
        from lerobot_pneutac.rendering.body import gel_film as film_of
    else:
        from lerobot_pneutac.rendering.body import body_film as film_of
    return film_of(twin, config)._replace(about=about(twin, config.recording or ""))


def draw_film(
    film: "Film",
    out: Path,
    progress: Progress = no_progress,
    written: Callable[[RenderedFilm], object] = lambda r: None,
    command: str = "",
) -> RenderedFilm:
    """Draws frames; if interrupted, what is finished is written, and `written` called with it.

    `command`, which does it again, is stored in `result.json`.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    pictures: list[np.ndarray] = []
    stills: list[dict] = []
    start = time.perf_counter()
    try:
        for frame in film.frames:
            pictures.append(frame.picture)
            if frame.row is not None:
                name = f"{film.device}_{len(stills) + 1}.png"
                write_image(out / name, frame.picture)
                stills.append(frame.row | {"picture": name})
            progress("bringing it to rest", len(pictures), film.count)
    finally:
        file = "film.mp4" if pictures else None
        complete, seconds = len(pictures) == film.count, time.perf_counter() - start
        result = RenderedFilm(film.device, complete, len(pictures), seconds, file, stills)
        if pictures:
            from lerobot.utils.io_utils import write_video

            write_video(out / file, pictures + [pictures[-1]] * FPS, FPS)
            report = Report(f"A {film.device} of material points")
            report.about = film.about
            report.lead(film.lead)
            report.videos([out / file], width=min(960, pictures[0].shape[1]))
            report.table(stills)
            for row in stills:
                report.image(np.asarray(Image.open(out / row["picture"])), row["picture"])
            report.write(out)
        write_result(out, result.to_dict() | ({"command": command} if command else {}))
        written(result)
    return result


# What helps where no equilibrium is found.
BODY_REMEDY = "give lower --pressure_kpa, more --particles, or a thicker mesh where the twin has its own"
GEL_REMEDY = "press less deep with --depth_mm, or give a larger indenter with --size_mm"


def command(config: RenderConfig, terminal: Terminal) -> None:
    twin = Twin.load(config.twin)
    config = filled(config, twin)
    with terminal.console.status("building the body"):
        film = make_film(twin, config)
    from pneutac_sim.mpm.solve import MpmDiverged

    results: list[RenderedFilm] = []
    try:
        terminal.run(draw_film, film, config.out, written=results.append, command=terminal.line)
    except MpmDiverged as e:
        remedy = GEL_REMEDY if twin.device == "gel" else BODY_REMEDY
        raise InputError(f"{e.finding}; {remedy}.") from e
    finally:
        for result in results:  # none where the disk is full
            terminal.show(result)
            end = "" if result.complete else f" (stopped after {result.frames} pictures of the film)"
            terminal.say(f"{config.out / (result.film or 'result.json')}{end}")
