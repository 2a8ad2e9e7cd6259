"""The free bend, which a bench told and demonstrations hardly do: it stays where they leave it open.

Touch tells how the bend changes while the finger presses, not how far it bends: where the object stands is
inferred from the touch itself. So a creep of minutes, or of the whole bend, would be free, and what the bench
told would be lost. A model is held to the bend that the twin had over a program of the measured pressure,
stairs and a long hold; what differs counts lightly, so that it decides where demonstrations do not.
"""

import numpy as np

from pneutac_sim.finger import Pipeline
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.twin import Twin
from pneutac_sim.world.conditions import USUAL

HZ = 5.0
STAIRS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2, 0.0)  # of the range
STAIR_S = 5.0  # on each
HELD, HELD_S, FREE_S = 0.8, 60.0, 25.0
LIGHTLY = 0.003  # what a mm^2 of the free bend counts beside one of touch, both in the mean


class FreeBend:
    """The bend of a finger that touches nothing.

    Args:
        twin: as it is.
        range_kpa: largest pressure of the program.
    """

    def __init__(self, twin: Twin, range_kpa: float):
        levels = [np.full(round(STAIR_S * HZ), s) for s in STAIRS]
        levels += [np.full(round(HELD_S * HZ), HELD), np.zeros(round(FREE_S * HZ))]
        pressure = range_kpa * np.concatenate(levels)[:, None]
        n = len(pressure)
        dt = np.append(np.inf, np.full(n - 1, 1 / HZ))
        columns = {name: np.full(n, value) for name, value in USUAL.items()}
        columns |= {"session_time_s": np.zeros(n), "length_mm": np.full(n, twin.length_mm)}
        self.inputs = Inputs(pressure, dt, np.arange(n), columns, True, range_kpa)
        pipeline = Pipeline.of(twin, self.inputs)
        self._known = self._bend(pipeline, pipeline.theta(twin, range_kpa))

    def _bend(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        return pipeline.run(self.inputs, theta).markers[:, 3]

    def apart(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(n,) by how much a model bends otherwise, rad.

        Args:
            pipeline: of the model; its input does not matter.
            theta: (P,) its parameters.
        """
        effects = [e.name for e in pipeline.effects]
        free = Pipeline(pipeline.geometry, effects, True, set(self.inputs.columns))
        return self._bend(free, theta) - self._known
