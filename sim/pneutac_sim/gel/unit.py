"""What the model leaves over on one sensor, for others of its make."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pneutac_sim.gel.residual import FEATURES, Leftover, ResidualField, learn

# Of a field that is lent: a finer or stronger one holds more that is the sensor's own.
CELLS, STRENGTH_LEVELS = 48, 8.0


@dataclass(frozen=True, eq=False)
class Unit:
    """One sensor of a make.

    Attributes:
        rest: its image without contact as a prior keeps it, (16, 12, 3) levels, by which it is known again.
        field: what the model leaves over on it, for a light of strength 1.
    """

    rest: np.ndarray
    field: ResidualField

    @classmethod
    def of(cls, rest: np.ndarray, leftovers: Sequence[Leftover], strength: float) -> "Unit":
        """From what a fit leaves over, of a light of this strength (levels per unit slope)."""
        return cls(rest, learn(leftovers, CELLS, STRENGTH_LEVELS).times(1 / strength))

    @classmethod
    def read(cls, content: dict[str, str], shape: tuple[int, int, int]) -> "Unit":
        """From `written`; the rest image has this shape.

        Raises:
            KeyError, TypeError, ValueError: it is no such thing.
        """
        rest = np.frombuffer(base64.b64decode(content["rest"], validate=True), np.uint8)
        field = np.frombuffer(base64.b64decode(content["field"], validate=True), "<f2")
        field = field.reshape(3, -1, FEATURES + 1).astype(np.float32)
        return cls(
            rest.reshape(shape).astype(np.float32), ResidualField(field[..., :FEATURES], field[..., FEATURES])
        )

    def written(self) -> dict[str, str]:
        """As text: levels as bytes, then z_j and c_j (3, n, 8) as 16-bit floats, in base64."""
        field = np.concatenate([self.field.centres, self.field.weights[..., None]], -1)
        return {
            "rest": base64.b64encode(self.rest.round().astype(np.uint8).tobytes()).decode(),
            "field": base64.b64encode(field.astype("<f2").tobytes()).decode(),
        }
