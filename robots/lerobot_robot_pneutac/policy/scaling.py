"""How the policy scales state and action: about what its demonstrations show, in units of what matters."""

from dataclasses import dataclass

import numpy as np
import torch

from pneutac_sim.features import (
    PANDA_JOINTS,
    PAPER_RANGE_KPA,
    PRESSURES,
    VELOCITY_NAMES,
    Places,
    action_limits,
    joint_count,
)

# What counts as much, whatever the station: much less than a robot's limits, so that millimetres matter.
JOINT_RAD, JOINT_RAD_S, POSITION_M, AREA, LOG_PIXELS = 0.3, 0.3, 0.01, 0.1, 4.0
# The paper's station: a Panda whose flange points down at the table.
_PANDA_RAD = [0.0, 0.0, 0.0, -2.55, 0.0, 2.55, np.pi / 4]
LEAST_KPA = 0.1  # half the width of a range of pressures, at least


@dataclass(frozen=True)
class Scaling:
    """Centre, scale of a state (2 N + 5 + C,), N joints, C chambers; centre, scale, limits of an action."""

    state_centre: np.ndarray
    state_scale: np.ndarray
    action_centre: np.ndarray
    action_scale: np.ndarray
    action_low: np.ndarray
    action_high: np.ndarray

    @classmethod
    def paper(cls, joints: int = PANDA_JOINTS, chambers: int = 1) -> "Scaling":
        """That of the paper's station and finger, or of others there, for a policy without data."""
        limits = action_limits(PAPER_RANGE_KPA, chambers)
        return cls(*_state(joints, chambers), *_middle(*limits), *limits)

    @classmethod
    def of(cls, stats: dict) -> "Scaling":
        """That of a dataset.

        Joints and flange are taken about the middle of where they were; pressures, which differ between
        fingers, over the range that was commanded; velocities over the robot's range.

        Args:
            stats: of LeRobot, with `min` and `max` of `observation.state` and `action`.
        """
        state, action = stats["observation.state"], stats["action"]
        middle = (np.ravel(state["min"]) + np.ravel(state["max"])) / 2
        chambers = np.size(action["min"]) - len(VELOCITY_NAMES)
        joints, places = joint_count(len(middle), chambers), Places.of(chambers)
        low, high = action_limits(PAPER_RANGE_KPA, chambers)
        centre, scale = _state(joints, chambers)
        centre[:joints], centre[places.ee] = middle[:joints], middle[places.ee]
        low[PRESSURES] = np.minimum(np.ravel(action["min"])[PRESSURES], 0.0)
        high[PRESSURES] = np.maximum(np.ravel(action["max"])[PRESSURES], 0.0)
        middle, half = _middle(low, high)
        half[PRESSURES] = np.maximum(half[PRESSURES], LEAST_KPA)
        centre[places.pressure], scale[places.pressure] = middle[PRESSURES], half[PRESSURES]
        return cls(centre, scale, middle, half, low, high)

    def tensors(self) -> dict[str, torch.Tensor]:
        return {f"_{name}": torch.tensor(value, dtype=torch.float32) for name, value in vars(self).items()}


def _state(joints: int, chambers: int) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale (2 N + 5 + C,) of the state of an arm of N joints at the paper's station."""
    angles = _PANDA_RAD if joints == PANDA_JOINTS else [0.0] * joints
    kpa = [7.5] * chambers
    centre = np.array([*angles, *[0.0] * joints, 0.46, 0.0, 0.28, 0.0, LOG_PIXELS, *kpa])
    scale = [JOINT_RAD] * joints + [JOINT_RAD_S] * joints + [POSITION_M] * 3 + [AREA, LOG_PIXELS, *kpa]
    return centre, np.array(scale)


def _middle(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half width of ranges."""
    return (low + high) / 2, (high - low) / 2
