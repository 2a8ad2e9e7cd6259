"""The torque of a finger's soft body, measured on material points that are held in many poses."""

import numpy as np

from pneutac_sim.finger.soft_body import SoftBody
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.twin import Twin

POSES_A_JOINT = 4
ALONE_RAD = (
    0.2  # how far a joint is bent by itself, at most; loads of half a newton bend the first by so much
)
TOLERANCE = 1e-3  # of unbalanced forces


def measure(
    twin: Twin, pressures_kpa: tuple[float, float], particles: int = 4000, device: str = "auto"
) -> SoftBody:
    """Holds the finger bent by pressures from least to largest, each joint slightly perturbed, and fits.

    Args:
        twin: of a finger; its modulus does not count, for torques are proportional to it.
        pressures_kpa: the least and the largest of use.
        particles: about how many.
        device: see `pneutac_sim.mpm.runtime.start`.
    """
    n = len(twin.spine_joint_positions_mm)
    poses, rng = POSES_A_JOINT * n, np.random.default_rng(0)
    free = devices.joint_targets(without_effects(twin), np.linspace(*pressures_kpa, poses))
    solver = devices.finger(twin, batch=poses, particles=particles, device=device)
    held = solve_equilibrium(
        solver, Loads(q_cmd=free + rng.uniform(-ALONE_RAD, ALONE_RAD, free.shape)), TOLERANCE
    )
    torque = held.body_torque.astype(float) / devices.parameter(twin, "youngs_modulus_mpa")
    rest = devices.joint_targets(without_effects(twin), [0.0])[0]
    return SoftBody.fit(held.q.astype(float), torque, rest)


def without_effects(twin: Twin) -> Twin:
    """The same finger by pressure alone."""
    plain = twin.copy()
    plain.effects = {}
    return plain
