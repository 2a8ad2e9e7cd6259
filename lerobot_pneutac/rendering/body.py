"""Frames of a finger or an arm: brought to rest pressure by pressure, drawn as particles or by its looks."""

import time
from collections.abc import Iterator

import numpy as np

from lerobot_pneutac.rendering import particles as draw
from lerobot_pneutac.rendering.film import (
    STRETCH,
    Film,
    FilmFrame,
    Painter,
    Pose,
    caption,
    pressure_text,
)
from lerobot_pneutac.rendering.options import FPS, RenderConfig
from lerobot_pneutac.rendering.photographs import photograph_painter, read_recorded
from lerobot_pneutac.rendering.view import view_painter
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.splat.stretch import MOST_STRAIN
from pneutac_sim.twin import Twin


def body_film(twin: Twin, config: RenderConfig) -> Film:
    """The film of a finger or an arm.

    Raises:
        InputError: the pressures do not fit the device, an effect cannot act, or there is nothing to see.
    """
    from pneutac_sim.mpm import devices

    recorded = None
    if config.recording is not None:
        recorded = read_recorded(twin, config)
    given = config.pressure_kpa
    if given is not None and len(given) % CHAMBERS[twin.device]:
        raise InputError(f"pressure_kpa has {len(given)} numbers; an arm takes three for each pose.")
    points = recorded.pressures if given is None else np.reshape(given, (-1, CHAMBERS[twin.device]))
    each = max(2, round(config.seconds * FPS))
    share = np.minimum(np.arange(1, each + 1) / (each // 2), 1.0)[:, None]
    program = np.concatenate(
        [points[:1]] + [a + share * (b - a) for a, b in zip(points[:-1], points[1:], strict=True)]
    )
    # A body was photographed at rest, so there each pressure has been held for long.
    time_s = np.arange(len(program)) / FPS if recorded is None else None
    conditions = config.conditions if recorded is None else recorded.conditions | config.conditions
    q_cmd = devices.joint_targets(twin, program, time_s, conditions)
    make = devices.BODIES[twin.device]
    solver = make(twin, particles=config.particles, device=config.device)
    spines = np.concatenate([devices.spine_points(solver, q[None]) for q in q_cmd])
    if recorded is not None:
        painter, lead = photograph_painter(twin, solver.body, recorded, spines)
    elif config.view is not None:
        painter, lead = view_painter(twin, solver.body, config.view, spines)
    else:
        painter, lead = _particle_painter(twin, solver.body.spacing_m), STRETCH
    return Film(twin.device, _frames(solver, program, q_cmd, each, painter), len(program), lead)


def _particle_painter(twin: Twin, spacing_m: float) -> Painter:
    turns = (24.0,) if twin.device == "finger" else (24.0, -66.0)  # an arm bends out of the plane
    length = 1e-3 * twin.length_mm

    def paint(pose: Pose) -> tuple[np.ndarray, dict]:
        return draw.body_picture(pose, length, spacing_m, caption(pose), MOST_STRAIN, turns), {}

    return paint


def _frames(
    solver, program: np.ndarray, q_cmd: np.ndarray, each: int, painter: Painter
) -> Iterator[FilmFrame]:
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.loads import Loads
    from pneutac_sim.mpm.solve import solve_equilibrium

    spent, rest = 0.0, None
    for k, (pressure, q) in enumerate(zip(program, q_cmd, strict=True)):
        start = time.perf_counter()
        if rest is None or not np.array_equal(q, q_cmd[k - 1]):
            rest = solve_equilibrium(solver, Loads(q_cmd=q[None]), warm=k > 0)
        spent += time.perf_counter() - start
        spine = devices.spine_points(solver, rest.q)[0]
        picture, more = painter(Pose(pressure, rest.positions[0], rest.gradients[0], spine))
        row = None
        if k % each == 0:
            row = {"pressure_kpa": pressure_text(pressure)[:-4] if len(pressure) > 1 else float(pressure[0])}
            row |= {f"tip_{a}_mm": float(1e3 * x) for a, x in zip("xyz", spine[-1], strict=True)}
            row |= more | {"seconds": spent}
            spent = 0.0
        yield FilmFrame(picture, row)
