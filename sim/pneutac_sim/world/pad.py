"""The plate that is the gel's face in MuJoCo, on a spring that has the force of the gel's own material.

Object and finger both feel that spring: it stands between the plate and the sensor's housing. Once a control
step it is taken from the law for what lies under or before the gel, as F = k1 x + k3 x^3, which holds force
and slope at the present depth and rises from zero at the resting face, whatever happens within the step.
"""

import mujoco
import numpy as np

from pneutac_sim.gel.force import GelForce
from pneutac_sim.gel.probe import NO_TRIANGLES, SPHERE
from pneutac_sim.gel.spring import GelSpring, Spring
from pneutac_sim.twin import Twin

MASS_KG = 0.0015
AHEAD_M = 0.001  # depth that may be reached within the control step
BALL_M = 0.004  # radius of what the face expects where nothing is near


class Pad:
    """The gel's face in a model with the slide joint `pad`.

    With steps h, a steepest slope k of the spring and a mass M = max(m, 2 h^2 k) the springs, which MuJoCo
    takes at the beginning of a step, are stable at any k, and a damping of M / 2h is small enough for the
    contact solver, which takes dampers there too. Where nothing is near the face has the spring of a ball, so
    that what it does follows from the present state alone.

    Attributes:
        spring: that acts.

    Args:
        model: of a scene with a finger.
        twin: whose gel it is.
        triangles: of the objects that are meshes, see `gel.probe.probe_grid`.

    Raises:
        InputError: the gel's material is out of range, see `GelForce`.
    """

    def __init__(self, model: mujoco.MjModel, twin: Twin, triangles: np.ndarray = NO_TRIANGLES):
        self._model, self._springs = model, GelSpring(GelForce.of(twin), triangles)
        self._joint = model.joint("pad").id
        self._dof = model.jnt_dofadr[self._joint]
        ball = [SPHERE], [(BALL_M, 0, 0)], [(0, 0, BALL_M)], [np.eye(3)]
        self._free = self._springs.of(*ball, np.zeros(3), np.eye(3))
        self.spring: Spring | None = None
        self.feel(None)

    def feel(self, objects: tuple | None) -> None:
        """Puts the spring for `objects`, arguments of `probe_grid`, into the model; None is nothing near."""
        spring = (objects and self._springs.of(*objects)) or self._free
        if spring is self.spring:
            return
        self.spring, m, h = spring, self._model, self._model.opt.timestep
        m.jnt_stiffness[self._joint] = self.spring.k1
        m.jnt_stiffnesspoly[self._joint] = 0.0, self.spring.k3
        mass = max(MASS_KG, 2 * h**2 * self.spring.slope(self.spring.depth_m + AHEAD_M))
        m.dof_armature[self._dof], m.dof_damping[self._dof] = mass - MASS_KG, mass / (2 * h)
