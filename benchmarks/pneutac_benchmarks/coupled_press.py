"""A finger that bends against a fixed bar: the world against material points of both body and gel.

Nothing sticks in either, as what friction holds depends on the way there. Both are at rest in the end: in
material points the joint angles are sought at which chamber, body and the gel's force on the bar balance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from pneutac_sim.gel.force import GelForce
from pneutac_sim.gel.spring import GelSpring
from pneutac_sim.twin import Twin
from pneutac_sim.world.mpm_gel import MpmFinger, MpmGel
from pneutac_sim.world.world import World

TOUCHES_KPA, GAP_M = 5.0, 0.001  # free pressure at which the bar stands so far before the gel
STEPS = 45  # control steps until the world is at rest
ROUNDS, BALANCED_NM = 12, 2e-4  # of the search for rest; torque left on a joint


@dataclass(frozen=True)
class Rest:
    """A finger at rest against the bar.

    Attributes:
        tip_m: (3,) in the world.
        area: share of the image in contact.
        force_n: on the gel along its view.
    """

    tip_m: np.ndarray
    area: float
    force_n: float


def coupled_press(twin: Twin, pressures_kpa: Sequence[float]) -> list[tuple[float, np.ndarray, Rest, Rest]]:
    """Of each pressure, raised in steps: the free tip (m), and the world's and the material points' rest."""
    world, free = (World("button", twin, "image", "surrogate") for _ in range(2))
    for w in (world, free):
        w.reset(0)
        w.model.geom_condim[:] = 1  # contacts without friction
        for _ in range(STEPS):
            w.step([0.0, 0.0, 0.0, TOUCHES_KPA])
    bar = world.model.geom("button").id
    normal = world.data.site("gel").xmat.reshape(3, 3)[:, 2]
    ahead = world.gel_m + normal * (world.model.geom_size[bar, 0] + GAP_M) - world.data.geom_xpos[bar]
    world.model.body_pos[world.model.body("button").id] += ahead
    free.model.body_pos[free.model.body("button").id] += [0.0, 0.0, -5.0]
    full, rows = _Full(twin, world), []
    for pressure in pressures_kpa:
        for _ in range(STEPS):
            world.step([0.0, 0.0, 0.0, pressure])
            free.step([0.0, 0.0, 0.0, pressure])
        own = Rest(world.data.site_xpos[world._tip].copy(), world.touch.area, world.press_n)
        rows.append((pressure, free.data.site_xpos[free._tip].copy(), own, full.rest(world)))
    return rows


class _Full:
    """Material points of finger and gel about the kinematics of a world."""

    def __init__(self, twin: Twin, world: World):
        self._body, self._gel, self._law = MpmFinger(twin), MpmGel(twin), GelForce.of(twin)
        self._springs, self._twin = GelSpring(self._law), twin
        self._model, self._data = world.model, mujoco.MjData(world.model)
        self._deep = 0.0

    def rest(self, world: World) -> Rest:
        """Joint angles at which all balances, from those of a world at rest."""
        model, data, spine = self._model, self._data, world._spine
        data.qpos[:] = world.data.qpos
        data.qpos[model.joint("pad").qposadr[0]] = 0.0
        drive, q = world._drive, world.spine_rad.copy()
        chamber = self._body.controller_nm_per_rad * np.eye(len(q))
        for _ in range(ROUNDS):
            data.qpos[spine] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            objects = world.touch.objects(data)
            force, surface = self._pressed(world, objects)
            R = data.site("gel").xmat.reshape(3, 3)
            arms = np.zeros((3, model.nv))
            at = data.site("gel").xpos + R @ self._middle_m(world, objects)
            mujoco.mj_jac(model, data, arms, None, at, model.site("gel").bodyid[0])
            arms = arms[:, spine]
            torque, J = self._body.torque(drive, q)
            left = chamber @ (drive - q) + torque + arms.T @ (R @ force)
            if np.abs(left).max() < BALANCED_NM:
                break
            spring = self._springs.of(*objects)
            stiff = spring.slope(max(1e-3 * world.sensor.probe(*objects).max(), 1e-4)) if spring else 0.0
            across = arms.T @ R[:, 2]
            q = q + np.linalg.solve(chamber - J + stiff * np.outer(across, across), left)
        else:
            raise RuntimeError(f"the press found no rest; {np.abs(left).max():.2g} N m are left")
        area = world.sensor.contact(world.sensor.draw(surface)).area
        return Rest(data.site_xpos[world._tip].copy(), area, -float(force[2]))

    def _pressed(self, world: World, objects: tuple) -> tuple[np.ndarray, np.ndarray]:
        """Force on the gel (3,) in N, gel frame, and the displacement of its face, mm."""
        self._gel.show(*objects)
        depth = world.sensor.probe(*objects)
        self._gel.friction = 0.0
        surface = self._gel.displacement(world.sensor.model.imprint(depth))
        return self._gel.force_n, surface

    def _middle_m(self, world: World, objects: tuple) -> np.ndarray:
        """Centre of pressure (3,) in the gel's frame."""
        p = self._law.pressure(world.sensor.probe(*objects))
        if not p.any():
            return np.zeros(3)
        rows, columns = p.shape
        width, height = self._law.window_mm
        x = ((np.arange(columns) + 0.5) / columns - 0.5) * width
        y = ((np.arange(rows) + 0.5) / rows - 0.5) * height
        return 1e-3 * np.array([p.sum(0) @ x / p.sum(), p.sum(1) @ y / p.sum(), 0.0])
