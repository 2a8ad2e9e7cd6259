"""How finger and gel of a world deform, by its fidelity, and whether the time step can follow them."""

import mujoco
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin
from pneutac_sim.world import scene


def deforming(twin: Twin, fidelity: str, touch: str):
    """What bends the finger, and what indents the gel; None for the formulas."""
    deforms = touch in ("image", "area")
    if fidelity == "surrogate":  # PyTorch and compilers take seconds to start
        from pneutac_sim.surrogate.networks import Networks

        networks = Networks.of(twin)
        return networks.finger(twin), networks.gel if deforms else None
    if fidelity == "mpm":
        from pneutac_sim.world.mpm_finger import MpmFinger
        from pneutac_sim.world.mpm_gel import MpmGel

        return MpmFinger(twin), MpmGel(twin) if deforms else None
    return None, None


def check_stability(
    model: mujoco.MjModel, data: mujoco.MjData, spine: slice, stiffness_nm_per_rad: float
) -> None:
    """Raises InputError where the finger's joint springs are too stiff for the time step.

    Args:
        model: of the world.
        data: at MuJoCo's default pose.
        spine: its joints.
        stiffness_nm_per_rad: of each.
    """
    n = model.nv
    M, K = np.zeros((n, n)), np.zeros(n)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    K[spine] = stiffness_nm_per_rad
    # w^2 = largest eigenvalue of M^-1 K; explicit springs are stable up to w dt = 2
    rate = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, np.diag(K))).real.max())
    if rate * scene.TIMESTEP > 1.9:
        largest = stiffness_nm_per_rad * (1.9 / (rate * scene.TIMESTEP)) ** 2
        raise InputError(
            f"Twin parameter 'joint_stiffness_nm_per_rad' is {stiffness_nm_per_rad:g}; the world can "
            f"integrate up to {largest:.2g} with this finger."
        )
