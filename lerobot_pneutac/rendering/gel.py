"""Frames of a gel under an indenter: the cut through its material points and the tactile image."""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lerobot_pneutac.rendering import particles as draw
from lerobot_pneutac.rendering.film import STRETCH, Film, FilmFrame
from lerobot_pneutac.rendering.options import RenderConfig, deepest_press
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.splat.stretch import strain
from pneutac_sim.twin import Twin

PRESS_FRAMES = 8  # depths on the way down
GEL_STRAIN = 0.8  # of the warmest colour
SIZE = {"cube": "side", "edge": "side", "outline": "reach", "mesh": "reach"}  # size_mm; of others the radius


def gel_film(twin: Twin, config: RenderConfig) -> Film:
    """The film of a gel.

    Raises:
        InputError: the indenter goes too deep, or misses the gel.
    """
    press = deepest_press(config, GelModel.from_twin(twin))
    lead = f"{STRETCH} Right: the tactile image, by Gaussian splats on the particles."
    return Film("gel", _frames(twin, config, press), PRESS_FRAMES, lead)


def _frames(twin: Twin, config: RenderConfig, press: Press) -> Iterator[FilmFrame]:
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.figure import distances_m
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.splat.gel import SplatSensor

    table = None if press.figure is None else distances_m(press.figure)
    solver = devices.gel(twin, device=config.device, table=table)
    model = GelModel.from_twin(twin)
    window, sensor = model.window_mm, SplatSensor(model)
    cells = solver.body.cells
    named = f"{press.indenter}, {SIZE.get(press.indenter, 'radius')} {press.size_mm:.3g} mm"
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
            strain(rest.gradients[0, cut]),
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
        yield FilmFrame(picture, values if last or k == PRESS_FRAMES // 2 - 1 else None)
