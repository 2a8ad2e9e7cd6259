"""The physics substeps of a control step, in one call."""

import mujoco
import numpy as np
from mujoco.rollout import Rollout

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


class Substeps:
    """Steps a model, bit for bit as a loop over `mj_step` does.

    Args:
        model: MuJoCo's.
        data: its state, which is stepped.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self._model, self._data = model, data
        self._rollout = Rollout(nthread=0)
        self._state = np.empty((1, mujoco.mj_stateSize(model, _FULL)))

    def run(self, ctrl: np.ndarray) -> None:
        """A substep for each row of controls (S, nu)."""
        mujoco.mj_getState(self._model, self._data, self._state[0], _FULL)
        # It steps the data itself, so its own record of the states is left aside.
        self._rollout.rollout(
            [self._model],
            [self._data],
            self._state,
            ctrl[None],
            initial_warmstart=self._data.qacc_warmstart[None].copy(),
            nstep=len(ctrl),
            skip_checks=True,
        )
