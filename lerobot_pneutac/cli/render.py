"""`pneutac render`: pictures and a film of a finger, arm or gel of material points under load."""

import json

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import show
from lerobot_pneutac.rendering.options import RenderConfig, filled
from lerobot_pneutac.verbs.render import RenderedFilm, draw_film, make_film
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

# What helps where no equilibrium is found.
BODY_REMEDY = "give lower --pressure_kpa, more --particles, or a thicker mesh where the twin has its own"
GEL_REMEDY = "press less deep with --depth_mm, or give a larger indenter with --size_mm"


def main(argv: list[str]) -> None:
    """Runs the verb; what is finished is kept and shown where it is interrupted."""
    config = parse_options(RenderConfig, argv)
    twin, console = Twin.load(config.twin), Console()
    config = filled(config, twin)
    with console.status("building the body"):
        film = make_film(twin, config)
    from pneutac_sim.mpm.solve import MpmDiverged

    try:
        with progress_bar(Console(stderr=True)) as progress:
            draw_film(film, config.out, progress)
    except MpmDiverged as e:
        remedy = GEL_REMEDY if twin.device == "gel" else BODY_REMEDY
        raise InputError(f"{e.finding}; {remedy}.") from e
    finally:
        result = RenderedFilm(**json.loads((config.out / "result.json").read_text()))
        show(result, console)
        end = "" if result.complete else f" (stopped after {result.frames} pictures of the film)"
        console.print(f"{config.out / (result.film or 'result.json')}{end}", highlight=False)
