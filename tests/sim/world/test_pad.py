"""The gel's face in MuJoCo: the law's spring, by the present state alone."""

import mujoco
import numpy as np
import pytest

from pneutac_sim.gel.probe import SPHERE
from pneutac_sim.world.world import World


@pytest.fixture(scope="module")
def world():
    return World("switch", touch="none")


def ball(radius_m, depth_m):
    """A ball in the gel's frame, arguments of `probe_grid`."""
    at = (0, 0, radius_m - depth_m)
    return [SPHERE], [(radius_m, 0, 0)], [at], [np.eye(3)], np.zeros(3), np.eye(3)


def test_the_model_has_the_springs_force_and_slope(world):
    pad, model, data = world._pad, world.model, world.data
    at = model.joint("pad")
    forces = []
    for x in (0.7e-3, 0.8e-3, 0.9e-3):
        world.reset(0)
        pad.feel(ball(0.006, 0.0008))
        data.qpos[at.qposadr[0]] = -x
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        forces.append(data.qfrc_spring[at.dofadr[0]])
    assert forces[1] == pytest.approx(pad.spring.force(0.8e-3))
    assert (forces[2] - forces[0]) / 0.2e-3 == pytest.approx(pad.spring.slope(0.8e-3), rel=0.02)


def test_where_nothing_is_near_what_was_pressed_before_does_not_matter(world):
    pad = world._pad
    pad.feel(None)
    free = pad.spring, world.model.dof_armature.copy(), world.model.dof_damping.copy()
    pad.feel(ball(0.002, 0.0015))
    assert pad.spring != free[0]
    pad.feel(ball(0.004, -0.05))
    assert pad.spring == free[0]
    assert np.array_equal(world.model.dof_armature, free[1])
    assert np.array_equal(world.model.dof_damping, free[2])


def test_a_face_that_is_dragged_off_stays_on_the_sensor():
    """Cards that rub along the gel's side, some 10 N each, once tore it off and ended an augmentation."""
    world = World("switch", touch="none")
    world.reset(0)
    pad = world.model.joint("pad")
    world.data.qfrc_applied[pad.dofadr[0]] = 40.0
    for _ in range(15):
        world.step([0, 0, 0, 0])  # would raise where the physics diverges
    assert 0.5e-3 < world.data.qpos[pad.qposadr[0]] < 2.1e-3
    world.data.qfrc_applied[:] = 0.0
    for _ in range(15):
        world.step([0, 0, 0, 0])
    assert world.data.qpos[pad.qposadr[0]] < 0.2e-3
