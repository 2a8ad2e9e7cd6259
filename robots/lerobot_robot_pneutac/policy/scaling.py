"""How the policy scales state and action: about what its demonstrations show, in units of what matters."""

from dataclasses import dataclass

import numpy as np
import torch

from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, EE, PANDA_JOINTS, PRESSURE, joint_count

# What counts as much, whatever the station: much less than a robot's limits, so that millimetres matter.
JOINT_RAD, JOINT_RAD_S, POSITION_M, AREA, LOG_PIXELS = 0.3, 0.3, 0.01, 0.1, 4.0
# The paper's station: a Panda whose flange points down at the table.
_PANDA_RAD = [0.0, 0.0, 0.0, -2.55, 0.0, 2.55, np.pi / 4]
LEAST_KPA = 0.1  # half the width of a range of pressures, at least


@dataclass(frozen=True)
class Scaling:
    """Centre, scale of the state (2 N + 6,) with N joints; centre, scale, limits of the action (4,)."""

    state_centre: np.ndarray
    state_scale: np.ndarray
    action_centre: np.ndarray
    action_scale: np.ndarray
    action_low: np.ndarray
    action_high: np.ndarray

    @classmethod
    def paper(cls, joints: int = PANDA_JOINTS) -> "Scaling":
        """That of the paper's station and finger, or of another arm there, for a policy without data."""
        return cls(*_state(joints), *_middle(ACTION_LOW, ACTION_HIGH), ACTION_LOW, ACTION_HIGH)

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
        joints, low, high = joint_count(len(middle)), ACTION_LOW.copy(), ACTION_HIGH.copy()
        centre, scale = _state(joints)
        centre[:joints], centre[EE] = middle[:joints], middle[EE]
        low[3], high[3] = min(np.ravel(action["min"])[3], 0.0), max(np.ravel(action["max"])[3], 0.0)
        middle, half = _middle(low, high)
        half[3] = max(half[3], LEAST_KPA)
        centre[PRESSURE], scale[PRESSURE] = middle[3], half[3]
        return cls(centre, scale, middle, half, low, high)

    def tensors(self) -> dict[str, torch.Tensor]:
        """The policy's buffers by name."""
        return {f"_{name}": torch.tensor(value, dtype=torch.float32) for name, value in vars(self).items()}


def _state(joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale (2 N + 6,) of the state of an arm of N joints at the paper's station."""
    angles = _PANDA_RAD if joints == PANDA_JOINTS else [0.0] * joints
    centre = np.array([*angles, *[0.0] * joints, 0.46, 0.0, 0.28, 0.0, LOG_PIXELS, 7.5])
    scale = [JOINT_RAD] * joints + [JOINT_RAD_S] * joints + [POSITION_M] * 3 + [AREA, LOG_PIXELS, 7.5]
    return centre, np.array(scale)


def _middle(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half width of ranges."""
    return (low + high) / 2, (high - low) / 2
