"""What an action has to be."""

import numpy as np

from pneutac_sim.errors import InputError


def checked_action(action) -> np.ndarray:
    """The action as float64 (4,), units of `features.ACTION_NAMES`.

    Raises:
        InputError: it has another shape or is not finite.
    """
    try:
        action = np.asarray(action, float)
    except (TypeError, ValueError) as e:
        raise InputError(f"The action must be 4 numbers (dx, dy, dz in m/s, pressure in kPa): {e}.") from e
    if action.shape != (4,):
        raise InputError(
            f"The action has shape {action.shape}; it must be (4,): dx, dy, dz in m/s, pressure in kPa."
        )
    if not np.isfinite(action).all():
        raise InputError(f"The action {action.tolist()} is not finite; every entry must be a number.")
    return action
