"""The first swing of a finger once a load is let go: of material points, and of the world's skeleton.

The chamber of stiffness K_c holds the spine where pressure alone would, a force bends it, and at zero time
the force is gone. A damped cosine fits frequency and damping of what follows.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pneutac_sim.mpm import devices, kernels
from pneutac_sim.mpm.solid import Links
from pneutac_sim.mpm.solve import simulate, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian
from pneutac_sim.surrogate import collect as programs
from pneutac_sim.twin import Twin, Value

PULLED_S, PULLED_PER_S = 0.3, 120.0  # how long the load bends the body, and how fast it comes to rest
FRAME_S = 0.002
SETTLED_S = 0.02  # in which faster swings than the first die away
STIFFNESS, DAMPING = "spine_stiffness_nm_per_rad", "spine_damping_nms_per_rad"


@dataclass(frozen=True)
class Swing:
    """A damped swing.

    Attributes:
        frequency_hz: of the damped motion.
        damping_ratio: 1 is critical.
    """

    frequency_hz: float
    damping_ratio: float

    @classmethod
    def of(cls, time_s: np.ndarray, bend: np.ndarray) -> "Swing":
        """The damped cosine nearest to a motion (T,) at times (T,)."""

        def misses(p):
            wave = p[2] * np.cos(p[0] * time_s) + p[3] * np.sin(p[0] * time_s)
            return np.exp(-p[1] * time_s) * wave + p[4] - bend

        fastest = min(20.0, 0.45 / (time_s[1] - time_s[0]))  # beyond, samples take it for a slow one
        starts = 2 * np.pi * np.geomspace(1.0, fastest, 10)
        ends = bend[-1]
        found = [least_squares(misses, [w, 0.2 * w, bend[0] - ends, 0.0, ends]) for w in starts]
        rate, decay = min(found, key=lambda f: f.cost).x[:2]
        return cls(abs(float(rate)) / (2 * np.pi), float(decay / np.hypot(rate, decay)))


def released(twin: Twin, controller: float, seconds: float = 0.5, sensor: Links | None = None) -> Swing:
    """The first swing of the full body at zero pressure, after a force across its tip.

    The law of the material has no losses: what damps it are the chamber, by the twin's
    `joint_damping_nms_per_rad`, and the numerics.

    Args:
        twin: of a finger.
        controller: stiffness K_c of the chamber, N m/rad.
        seconds: of the swing.
        sensor: lumps that the last link carries; None for none.
    """
    at, free = programs.joint_targets(twin, 0.0)[None], twin.copy()
    held = solve_equilibrium(devices.finger(twin), Loads(q_cmd=at), tolerance=1e-3)
    target = held.q - held.body_torque / controller  # where the chamber would bend the spine without body
    levers = 1e-3 * (twin.length_mm - np.asarray(twin.spine_joint_positions_mm))
    free.parameters |= {
        STIFFNESS: Value(controller),
        DAMPING: Value(twin.parameter("joint_damping_nms_per_rad")),
    }
    solver = devices.finger(free)
    if sensor is not None:
        carry(solver, sensor)
    solver.set_q(held.q)
    pulled = Loads(q_cmd=target + 0.1 * levers / controller)  # 0.1 N
    simulate(solver, pulled, PULLED_S, PULLED_S / 30, damping=PULLED_PER_S, particles=False)
    run = simulate(solver, Loads(q_cmd=target), seconds, FRAME_S, particles=False)
    late = run.time_s >= SETTLED_S
    return Swing.of(run.time_s[late], run.q[late, 0] @ levers)


def carry(solver: TotalLagrangian, more: Links) -> None:
    """Adds lumps to what the last link carries."""
    density = solver.body.material.density_kg_m3
    lumps = solver.arrays["lump"].to_numpy().reshape(-1, kernels.LUMP).astype(float)
    own = lumps[-1]
    parts = [
        (own[0] * density, own[1:4], own[4:].reshape(3, 3) * density),
        *zip(more.mass_kg, more.centre_m, more.inertia_kg_m2, strict=True),
    ]
    mass = sum(m for m, _, _ in parts)
    centre = sum(m * c for m, c, _ in parts) / mass
    inertia = sum(
        i + m * ((c - centre) @ (c - centre) * np.eye(3) - np.outer(c - centre, c - centre))
        for m, c, i in parts
    )
    lumps[-1] = np.concatenate([[mass / density], centre, inertia.ravel() / density])
    solver.arrays["lump"].from_numpy(kernels.flat(lumps))
