"""The pipeline one control step at a time, for the environment and for real time."""

import math
from collections.abc import Mapping

import numpy as np

from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.stages import EffectLink, LoadLink, Markers
from pneutac_sim.twin import Twin


class PressurePipeline:
    """Turns commanded pressures into joint targets, with every effect of the twin up to the body.

    Loads are left to the simulator that the finger stands in (it knows gravity and contact), and so are
    observation effects. On a uniform grid the result equals `Pipeline.run` without those.

    Args:
        twin: a `finger` or an `arm`.

    Attributes:
        pressure_kpa: (chambers,) in the chambers after the last step.
    """

    def __init__(self, twin: Twin):
        self._model = Pipeline.of(twin)
        self._theta = self._model.theta(twin)
        self._arm = self._model.geometry.axes == 2
        links = [e for e in self._model.chain if not isinstance(e, LoadLink)]
        self._links = links[: [isinstance(e, Markers) for e in links].index(True)]
        self.reset()

    def reset(self, pressure_kpa: float | np.ndarray = 0.0) -> None:
        """A new, rested device that has long been at this pressure."""
        n = self._model.geometry.chambers
        self.pressure_kpa = np.broadcast_to(np.asarray(pressure_kpa, dtype=float), (n,)).copy()
        self._states: list[np.ndarray] | None = None
        self._time_s = 0.0
        self._rested = self.pressure_kpa.copy()

    def step(
        self,
        pressure_cmd_kpa: float | np.ndarray,
        dt_s: float,
        conditions: Mapping[str, float] | None = None,
    ) -> np.ndarray:
        """Advances by one control step.

        Args:
            pressure_cmd_kpa: command, a number or (chambers,).
            dt_s: length of the step.
            conditions: what effects ask for, such as `temperature_c`; an effect without its columns rests.

        Returns:
            Joint targets q_cmd, (N,) for a finger, (N, 2) for an arm, rad.
        """
        given = dict(conditions or {}) | {"length_mm": self._model.geometry.length_mm}
        if self._states is None:
            self._advance(self._rested, math.inf, given | {"session_time_s": 0.0})
        self._time_s += dt_s
        return self._advance(pressure_cmd_kpa, dt_s, given | {"session_time_s": self._time_s})

    def _advance(self, command: float | np.ndarray, dt_s: float, given: dict[str, float]) -> np.ndarray:
        def conditions(names):
            return np.array([[given[c] for c in names]], dtype=float).reshape(1, -1)

        x = np.broadcast_to(np.asarray(command, dtype=float), (1, self._model.geometry.chambers))
        new = self._states is None
        self._states = [] if new else self._states
        for i, link in enumerate(self._links):
            if new:
                self._states.append(np.zeros(link.state_size(x.shape[1])))
            if i == self._model.reads_pressure:
                self.pressure_kpa = x[0].copy()
            if isinstance(link, EffectLink) and any(c not in given for c in link.effect.columns):
                continue
            x = link(x, np.array([dt_s]), self._theta, conditions, self._states[i])
        return x.reshape(-1, 2) if self._arm else x[0]
