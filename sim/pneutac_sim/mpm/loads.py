"""What acts on bodies, as a user states it and as the kernels read it."""

from dataclasses import dataclass, field

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.indenter import SHAPES
from pneutac_sim.mpm.state import FRICTION, GRAVITY, POSE, SIZE


@dataclass
class Loads:
    """What acts on each body of a batch."""

    q_cmd: np.ndarray | None = None  # (B, H) joint targets, rad
    gravity: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) or (B, 3) m/s2
    indenter: str | list[str] = "none"  # one of `indenter.SHAPES` or one a body
    # (3,) or (B, 3) m, see `indenter.distance`
    size_m: np.ndarray = field(default_factory=lambda: np.ones(3))
    # (3,) or (B, 3) of the indenter's tip, m
    position_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # (3, 3) or (B, 3, 3) of the indenter, whose body lies towards its own +z
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    friction: float | np.ndarray = 0.5  # Coulomb's coefficient, or (B,)

    def fill(self, row: np.ndarray) -> None:
        """Writes itself into the rows (B, LOAD) that the kernels read."""
        batch = len(row)
        row[:, GRAVITY : GRAVITY + 3] = self.gravity
        row[:, POSE : POSE + 9] = np.broadcast_to(self.rotation, (batch, 3, 3)).reshape(batch, 9)
        row[:, POSE + 9 : POSE + 12] = self.position_m
        row[:, SIZE : SIZE + 3] = self.size_m
        row[:, FRICTION] = self.friction

    def shapes(self, batch: int) -> np.ndarray:
        """(B,) number of each body's indenter; raises InputError where there is no such indenter."""
        names = [self.indenter] * batch if isinstance(self.indenter, str) else list(self.indenter)
        unknown = set(names) - set(SHAPES)
        if unknown:
            raise InputError(f"There is no indenter '{unknown.pop()}'; there are {', '.join(SHAPES)}.")
        return np.array([SHAPES.index(n) for n in names], np.int32)

    def targets(self, batch: int, hinges: int) -> np.ndarray:
        """(B, H) rad, nothing where none were given."""
        return np.broadcast_to(0.0 if self.q_cmd is None else np.asarray(self.q_cmd, float), (batch, hinges))
