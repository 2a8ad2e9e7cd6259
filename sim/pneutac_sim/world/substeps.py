"""Physics substeps of a control step in one call."""

import mujoco
import numpy as np
from mujoco.rollout import Rollout

_STATE = mujoco.mjtState
_FULL = _STATE.mjSTATE_FULLPHYSICS
# What is not named here a rollout sets to zero: forces that are applied from outside would be lost.
_INPUTS = _STATE.mjSTATE_CTRL | _STATE.mjSTATE_QFRC_APPLIED | _STATE.mjSTATE_XFRC_APPLIED


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
        """A substep for each row of controls (S, nu), under the forces that are applied in the data."""
        model, data = self._model, self._data
        mujoco.mj_getState(model, data, self._state[0], _FULL)
        inputs = np.empty((1, len(ctrl), model.nu + model.nv + 6 * model.nbody))
        inputs[..., : model.nu] = ctrl
        inputs[..., model.nu : model.nu + model.nv] = data.qfrc_applied
        inputs[..., model.nu + model.nv :] = data.xfrc_applied.ravel()
        # It steps the data itself, so its own record of the states is left aside.
        self._rollout.rollout(
            [model],
            [data],
            self._state,
            inputs,
            control_spec=_INPUTS,
            initial_warmstart=data.qacc_warmstart[None].copy(),
            nstep=len(ctrl),
            skip_checks=True,
        )
