"""How the stiffness of a finger's joints is shared between the chamber's controller and the soft body."""

import numpy as np
from scipy.optimize import brentq

from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


def controller_stiffness(twin: Twin, body: np.ndarray) -> float:
    """K_c in N m/rad: what is left of the twin's `joint_stiffness_nm_per_rad` without its soft body.

    Loaded poses on the bench tell the whole, by how far a load at the tip moves it. With the moments w of a
    force across the straight finger's tip, K_c solves w^T (K_c - J)^-1 w = w^T w / K_joint.

    Args:
        twin: of a finger.
        body: (N, N) derivative J of the body's torques by the joint angles at rest, N m/rad.

    Raises:
        InputError: the body alone is stiffer than the whole.
    """
    whole = twin.parameter("joint_stiffness_nm_per_rad")
    w = twin.length_mm - np.asarray(twin.spine_joint_positions_mm)
    values, vectors = np.linalg.eigh(-body)
    share = (vectors.T @ w) ** 2 / (w @ w)
    least = max(1e-3 * whole, 1e-3 * whole - values.min())  # stable by itself

    def softness(K: float) -> float:
        return float((share / (K + values)).sum() - 1 / whole)

    if softness(least) <= 0:
        alone = 1 / (softness(least) + 1 / whole)
        raise InputError(
            f"The soft body alone resists a load at the tip with {alone:.3g} N m/rad a joint, more than the "
            f"twin's joint_stiffness_nm_per_rad of {whole:.3g}: 'youngs_modulus_mpa' is too high or that "
            "too low; calibrate with rows that hang a weight on the tip (payload_g)."
        )
    return brentq(softness, least, whole + max(0.0, -values.min()) + least)
