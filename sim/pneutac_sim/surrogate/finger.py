"""The soft body round the world's spine by the action network, in place of `world.mpm_finger.MpmFinger`.

The chamber drives the spine with a controller of finite stiffness K_c, the body resists with its own:

    M q'' + D q' = K_c (q_free - q) + f_r(q, 0, p) - f_r(q_free, 0, p)

where q_free is the bend that the twin's pipeline commands. It was calibrated with the body on the spine, so
what that takes back of the free bend is in q_free already. Swing and mass are the world's own. Motion of the
finger alone over time is `ActionNetwork.roll`.
"""

from dataclasses import replace

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm import devices
from pneutac_sim.surrogate import programs
from pneutac_sim.surrogate.fingerprint import fingerprint
from pneutac_sim.surrogate.network import ActionNetwork
from pneutac_sim.surrogate.stiffness import controller_stiffness
from pneutac_sim.twin import Twin


def network_of(twin: Twin, network: ActionNetwork) -> ActionNetwork | None:
    """The network for a twin's own Young's modulus; None where it was trained for another body.

    At given angles an elastic body's torque is proportional to its modulus. That f_r also holds by how much
    the body lags behind its spine, which is not, is left aside.

    Args:
        twin: of a finger.
        network: trained for its body, of any modulus. A file of an earlier version does not state its modulus
            and is good for that of its training alone.
    """
    if network.fingerprint != fingerprint(twin, network.modulus_mpa):
        return None
    modulus = devices.parameter(twin, "youngs_modulus_mpa")
    if network.modulus_mpa in (None, modulus):
        return network
    ratio = modulus / network.modulus_mpa
    scaled = {name: ratio * getattr(network, name) for name in ("slope", "torque_mean", "torque_scale")}
    return replace(network, **scaled, fingerprint=fingerprint(twin), modulus_mpa=modulus)


class SurrogateFinger:
    """The soft body of one finger.

    Args:
        twin: of a finger.
        network: trained for its body, see `network_of`.

    Attributes:
        controller_nm_per_rad: K_c, see `stiffness.controller_stiffness`.
        in_range: whether the last step was in the range in which the network was trained. Where it was not,
            the body's torque goes on straight.

    Raises:
        InputError: the network was trained for another body, or the body is stiffer than the whole finger.
    """

    def __init__(self, twin: Twin, network: ActionNetwork):
        own = network_of(twin, network)
        if own is None:
            raise InputError(
                "The action network was trained for another body, or for this one before its shape or "
                "material changed; train it again with `pneutac surrogate`."
            )
        self.network = own
        rest = programs.joint_targets(twin, 0.0)
        self.controller_nm_per_rad = controller_stiffness(twin, self.torque(rest, rest)[1])
        self.reset()

    def reset(self) -> None:
        """Does nothing: a network has no state."""
        self.in_range = True

    def torque(self, q_free: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the body does to the joints at `q` beyond what it does at `q_free`.

        Args:
            q_free: (N,) where the unloaded finger rests, rad.
            q: (N,) joint angles, rad.

        Returns:
            (N,) torques in N m and their symmetric derivative (N, N) by `q` in N m/rad.

        Raises:
            InputError: an angle is not a finite number.
        """
        q_free, q = np.asarray(q_free, float), np.asarray(q, float)
        if not (np.isfinite(q_free).all() and np.isfinite(q).all()):
            raise InputError("A joint angle of the finger is not a finite number.")
        torque, J, self.in_range = self.network.resistance(q_free, q)
        return torque, J
