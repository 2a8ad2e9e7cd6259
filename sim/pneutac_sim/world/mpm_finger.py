"""The full material point finger in the world: bends the joints that the skeleton bends by a formula.

Each control step the body is brought to rest, starting from the step before: 25 substeps while the pressure
stands, about 650 (0.25 s) while it moves. Moving it through the same 1/15 s in true time takes 2,200, always;
what that would add, the slow motion of the finger with the mass of its sensor, is the world's own already, by
the joint springs and dampers of the twin.

Contact and weight come in as torques about the spine's joints. They bend it as far as the twin's
`joint_stiffness_nm_per_rad` says, since the spine's controller is a stiff servo. What is missing: the soft
body does not feel where it is touched, so its skin is not dented. The gel is `world.mpm_gel`'s.
"""

import numpy as np

from pneutac_sim.mpm import devices
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.twin import Twin


class MpmFinger:
    """One finger of material points, at rest under what acts in this control step.

    Args:
        twin: of a finger.
        particles: about how many.
        device: see `pneutac_sim.mpm.runtime.start`.

    Attributes:
        solver: the bodies, for pictures.
        substeps: taken in the last step.
        in_range: always; there is no range to leave.
    """

    in_range = True

    def __init__(self, twin: Twin, particles: int = 4000, device: str = "auto"):
        self.solver = devices.finger(twin, particles=particles, device=device)
        self._compliance = 1 / twin.parameter("joint_stiffness_nm_per_rad")

    def bend(self, q_cmd: np.ndarray, torque: np.ndarray | None = None) -> np.ndarray:
        """Joint angles (N,) in rad at which the finger rests.

        Args:
            q_cmd: (N,) joint targets of the pressure, rad.
            torque: (N,) N m about the joints from outside; None starts afresh, from the straight finger.
        """
        warm = torque is not None
        target = np.asarray(q_cmd, float) + (self._compliance * torque if warm else 0.0)
        rest = solve_equilibrium(self.solver, Loads(q_cmd=target[None]), warm=warm)
        self.substeps = rest.substeps
        return rest.q[0].astype(float)
