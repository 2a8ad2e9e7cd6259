"""The material points of a finger or an arm at rest, for the picture of the studio."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.stretch import MOST_STRAIN, strain, stretch_colours
from pneutac_sim.twin import Twin

PARTICLES = 3000


@dataclass(frozen=True)
class Solid:
    """Material points at rest.

    Attributes:
        points_mm: (P, 3).
        colours: (P, 3) uint8, by how far each is stretched.
        splats: the body's Gaussians, in the twin's own looks where it has any.
        most_strain: largest principal strain, a share.
        tip_mm: (3,) where the spine ends.
    """

    points_mm: np.ndarray
    colours: np.ndarray
    splats: Gaussians
    most_strain: float
    tip_mm: np.ndarray


def solve(
    twin: Twin,
    pressure_kpa: np.ndarray,
    conditions: Mapping[str, float],
    progress: Progress = no_progress,
) -> Solid:
    """Brings the body to rest at pressures (chambers,) held for long; `progress` as of `solve_equilibrium`.

    Raises:
        InputError: an effect of the twin moves the tip alone, which material points do not follow.
    """
    from lerobot_pneutac.rendering.view import body_looks
    from pneutac_sim.mpm import devices  # brings the compiler of kernels, which takes a second
    from pneutac_sim.mpm.loads import Loads
    from pneutac_sim.mpm.solve import solve_equilibrium

    q = devices.joint_targets(twin, pressure_kpa[None], conditions=conditions)
    solver = devices.BODIES[twin.device](twin, particles=PARTICLES, device="cpu")
    rest = solve_equilibrium(solver, Loads(q_cmd=q), progress=progress)
    stretched = strain(rest.gradients[0])
    return Solid(
        points_mm=1e3 * rest.positions[0],
        colours=stretch_colours(stretched, MOST_STRAIN).astype(np.uint8),
        splats=body_looks(twin, solver.body)(rest.positions[0], rest.gradients[0]),
        most_strain=float(stretched.max()),
        tip_mm=1e3 * devices.spine_points(solver, rest.q)[0, -1],
    )
