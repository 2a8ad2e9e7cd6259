"""The full material point finger in the world: bends the joints that the skeleton bends by a formula.

Each control step the body is brought to rest, starting from the step before: 25 substeps while the pressure
stands, about 650 (0.25 s) while it moves. Moving it through the same 1/15 s in true time takes 2,200, always;
what that would add, the slow motion of the finger with the mass of its sensor, is the world's own already, by
the joint springs and dampers of the twin.

The twin's pipeline was calibrated with the soft body on the spine: what the body takes back of the bend, a
few percent, is in its joint targets already. So each is raised by what was taken back in the step before.

Contact comes in as torques about the spine's joints. It bends it as far as the twin's
`joint_stiffness_nm_per_rad` says, since the spine's controller is a stiff servo. What is missing: the soft
body does not feel where it is touched, so its skin is not dented. The gel is `world.mpm_gel`'s.
"""

import numpy as np

from pneutac_sim.mpm import devices
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.twin import Twin

STRAIGHT_RAD = 0.02  # a joint bent less tells too little of what the body takes back


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
        self._raised = np.ones(len(twin.spine_joint_positions_mm))

    def bend(self, q_cmd: np.ndarray, torque: np.ndarray | None = None) -> np.ndarray:
        """Joint angles (N,) in rad at which the finger rests.

        Args:
            q_cmd: (N,) joint targets of the pressure, rad.
            torque: (N,) N m about the joints from outside; None starts afresh, from the straight finger.
        """
        warm, q_cmd = torque is not None, np.asarray(q_cmd, float)
        self.substeps = 0
        if not warm:
            self._raised[:] = 1.0
        for first in (False,) if warm else (True, False):  # afresh, what the body takes back is not known yet
            load = self._compliance * torque if warm else 0.0
            target = q_cmd * self._raised + load
            rest = solve_equilibrium(self.solver, Loads(q_cmd=target[None]), warm=warm or not first)
            q = rest.q[0].astype(float)
            self.substeps += rest.substeps
            bent = np.abs(q) > STRAIGHT_RAD
            self._raised = np.where(bent, target / np.where(bent, q, 1.0), 1.0)
        return q
