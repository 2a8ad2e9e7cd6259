"""How the stiffness of a finger's joints is shared between the chamber's controller and the soft body."""

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.finger.soft_body import share_of_controller
from pneutac_sim.twin import Twin


def controller_stiffness(twin: Twin, body: np.ndarray) -> float:
    """K_c in N m/rad: what is left of the twin's `joint_stiffness_nm_per_rad` without its soft body.

    Args:
        twin: of a finger.
        body: (N, N) derivative J of the body's torques by the joint angles at rest, N m/rad.

    Raises:
        InputError: the body alone is stiffer than the whole.
    """
    whole = twin.parameter("joint_stiffness_nm_per_rad")
    levers = twin.length_mm - np.asarray(twin.spine_joint_positions_mm)
    controller = share_of_controller(whole, -body, levers)
    if controller == 0.0:
        alone = (levers @ levers) / (levers @ np.linalg.solve(-body, levers))
        raise InputError(
            f"The soft body alone resists a load at the tip with {alone:.3g} N m/rad a joint, more than the "
            f"twin's joint_stiffness_nm_per_rad of {whole:.3g}: 'youngs_modulus_mpa' is too high or that "
            "too low; calibrate with rows that hang a weight on the tip (payload_g)."
        )
    return controller
