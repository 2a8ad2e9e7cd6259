"""The torques that lead the free finger on its path: against MuJoCo's own dynamics."""

import mujoco
import numpy as np
import pytest

from pneutac_sim.twin import Twin
from pneutac_sim.world.following import Follower
from pneutac_sim.world.scene import PHYSICS_HZ
from pneutac_sim.world.soft_finger import Springs, mjcf

JOINTS = 4


@pytest.fixture(scope="module")
def model():
    """A finger of the world on a base that stands still."""
    finger = mjcf(Twin.builtin())
    materials = '<material name="arm_dark"/>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{1 / PHYSICS_HZ!r}" integrator="implicitfast"'
        f' gravity="0 0 0"/><default>{finger.defaults}</default><asset>{finger.materials}{materials}</asset>'
        f"<worldbody>{finger.body}</worldbody><actuator>{finger.actuators}</actuator>{finger.tendons}</mujoco>"
    )


def test_a_free_finger_goes_along_the_path_whatever_its_stiffness(model):
    """Where the gel's pad is held, to rounding: each control step ends at its target, at the rate told."""
    model.dof_armature[model.joint("pad").dofadr[0]] = 1e9
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    springs, follower = Springs(model, JOINTS, 0.006, 0.458), Follower(model, JOINTS)
    at, rate = np.array([0.2, 0.1, 0.15, 0.1]), np.zeros(JOINTS)
    data.qpos[:JOINTS] = at
    for stiffness in (0.4, 0.1, 1.0, 0.4, 0.4):
        K = stiffness * np.eye(JOINTS) + 0.04 * (np.eye(JOINTS, k=1) + np.eye(JOINTS, k=-1))
        target = at + rng.uniform(-0.15, 0.15, JOINTS)
        torques, end = follower.torques(at, rate, target, K, springs.set(K), 50)
        for row in torques:
            data.ctrl[:] = row
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(data.qpos[:JOINTS], target, atol=2e-6)
        np.testing.assert_allclose(data.qvel[:JOINTS], end, atol=2e-4)
        np.testing.assert_allclose(end, (target - at) / (50 * model.opt.timestep), rtol=1e-9)
        at, rate = target, end


def test_a_steady_pressure_takes_the_springs_torque_alone(model):
    K, at = 0.4 * np.eye(JOINTS), np.full(JOINTS, 0.1)
    D = Springs(model, JOINTS, 0.006, 0.458).set(K)
    torques, rate = Follower(model, JOINTS).torques(at, np.zeros(JOINTS), at, K, D, 50)
    np.testing.assert_allclose(torques, np.tile(K @ at, (50, 1)), atol=1e-12)
    assert not rate.any()
