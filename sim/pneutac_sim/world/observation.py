"""What a robot in a world senses."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Observation:
    """What a robot senses once a control step.

    Attributes:
        state: (2 N + 5 + C,) float32 as `features.state_names` of an arm of N joints and C chambers.
        tactile: uint8 (H, W, 3) of the sensor's size, or None where the world has no image.
    """

    state: np.ndarray
    tactile: np.ndarray | None
