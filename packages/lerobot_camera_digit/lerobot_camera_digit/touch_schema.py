"""How touch is named and laid out in observations and datasets: the one place to change when LeRobot decides.

LeRobot's proposed tactile module (huggingface/lerobot, pull request 4469, not merged when this was written)
settles that a sensor gives a set of points with `displacement` (dx, dy, dz), `force` (Fx, Fy, Fz), both
(`full`) or a `wrench`. It leaves open how `observation.tactile.*` lands in a dataset.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TouchSchema:
    """Names and layout.

    Attributes:
        area: name of the contact area in a robot's observation, `{sensor}` stands for the camera's name.
        depth: of the depth image (H, W, 1).
        points: of the points.
        grid: rows and columns of points; about a millimetre apart on a DIGIT.
        data_type: what a point has, by the names of pull request 4469.
        values: of a point.
        flat: whether points are stored as one vector, since LeRobot 0.6 merges no datasets with other arrays.
    """

    area: str = "{sensor}.contact_area.pos"
    depth: str = "{sensor}.depth"
    points: str = "{sensor}.points"
    grid: tuple[int, int] = (16, 12)
    data_type: str = "displacement"
    values: tuple[str, ...] = ("dx", "dy", "dz")
    flat: bool = True

    def stored(self, points: np.ndarray) -> np.ndarray:
        """Points (rows, columns, values) as they are stored: one vector, or (rows columns, values)."""
        return points.ravel() if self.flat else points.reshape(-1, len(self.values))


LEROBOT_0_6 = TouchSchema()
PULL_REQUEST_4469 = TouchSchema(flat=False)
SCHEMA = LEROBOT_0_6
