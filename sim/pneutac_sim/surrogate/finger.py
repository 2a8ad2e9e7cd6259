"""The action network in the world's finger: takes the place of `world.mpm_finger.MpmFinger`.

Like that one it bends to where the finger rests under what acts in this control step, free as the twin's
pipeline says, so the two agree as far as the network is right: the swing of the finger, with the mass of its
sensor, is the world's own, by the joint springs and dampers of the twin. Motion of the
finger alone over time is `ActionNetwork.roll`.
"""

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.surrogate.fingerprint import fingerprint
from pneutac_sim.surrogate.network import ActionNetwork
from pneutac_sim.surrogate.programs import bending_pressure
from pneutac_sim.twin import Twin


class SurrogateFinger:
    """One finger, at rest under what acts in this control step.

    Args:
        twin: of a finger.
        network: trained for it.

    Attributes:
        in_range: whether the last step was in the range in which the network was trained. Where it was not,
            the skeleton's own spring acts with the torque of the nearest state that was.

    Raises:
        InputError: the network was trained for another twin.
    """

    def __init__(self, twin: Twin, network: ActionNetwork):
        if network.fingerprint != fingerprint(twin):
            raise InputError(
                "The action network was trained for another twin, or for this one before its parameters or "
                "effects changed; train it anew with `pneutac surrogate`."
            )
        self.network = network
        self.in_range = True
        self._twin = twin
        self._compliance = 1 / twin.parameter("joint_stiffness_nm_per_rad")

    def bend(self, q_cmd: np.ndarray, torque: np.ndarray | None = None) -> np.ndarray:
        """Joint angles (N,) in rad at which the finger rests.

        Args:
            q_cmd: (N,) joint targets of the pressure, rad.
            torque: (N,) N m about the joints from outside; None for no load.

        Raises:
            InputError: a joint target or torque is not a finite number.
        """
        q_cmd = np.asarray(q_cmd, float)
        pressure, K = bending_pressure(self._twin, q_cmd), self.network.skeleton.stiffness_nm_per_rad
        # The pipeline was calibrated with the soft body on the spine, so what that takes back of the bend of
        # the free finger, f_r(q_cmd) / K, is in its joint targets already.
        free = self.network.torque(q_cmd[None], np.zeros((1, len(q_cmd))), [pressure])[0]
        target = q_cmd - free / K + (0.0 if torque is None else self._compliance * torque)
        if not np.isfinite(target).all():
            raise InputError("A joint target or torque of the finger is not a finite number.")
        q, self.in_range = self.network.rest(target, pressure)
        return q
