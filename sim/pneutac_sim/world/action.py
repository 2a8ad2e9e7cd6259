"""What an action has to be."""

import numpy as np

from pneutac_sim.errors import InputError


def checked_action(action, chambers: int = 1) -> np.ndarray:
    """The action as float64 (3 + C,) of a finger of C chambers, units of `features.action_names`.

    Raises:
        InputError: it has another shape or is not finite.
    """
    size = 3 + chambers
    what = f"dx, dy, dz in m/s, {'pressure' if chambers == 1 else f'{chambers} pressures'} in kPa"
    try:
        action = np.asarray(action, float)
    except (TypeError, ValueError) as e:
        raise InputError(f"The action must be {size} numbers ({what}): {e}.") from e
    if action.shape != (size,):
        raise InputError(f"The action has shape {action.shape}; it must be ({size},): {what}.")
    if not np.isfinite(action).all():
        raise InputError(f"The action {action.tolist()} is not finite; every entry must be a number.")
    return action
