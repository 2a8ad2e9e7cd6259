"""The arm: kinematics against the closed form, inverse kinematics, servo tracking."""

import mujoco
import numpy as np
import pytest

from pneutac_sim.features import JOINT_HIGH, JOINT_LOW
from pneutac_sim.world import panda
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

DT = Station().dt_s


def simulated_flange(q):
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler angle='radian'/><default>{panda.DEFAULTS}</default>"
        f"<asset>{panda.MATERIALS}</asset><worldbody>{panda.body()}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    site = data.site("flange")
    return site.xpos.copy(), site.xmat.reshape(3, 3).copy()


def test_mjcf_agrees_with_the_dh_table():
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = rng.uniform(JOINT_LOW, JOINT_HIGH)
        T = panda.forward_kinematics(q)
        position, rotation = simulated_flange(q)
        np.testing.assert_allclose(position, T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(rotation, T[:3, :3], atol=1e-12)


def test_closed_form_at_poses_that_can_be_checked_by_hand():
    # All zero: the arm stands straight up, the last link hangs over by 88 mm and points down.
    T = panda.forward_kinematics(np.zeros(7))
    np.testing.assert_allclose(T[:3, 3], [0.088, 0, 0.333 + 0.316 + 0.384 - 0.107], atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], [0, 0, -1], atol=1e-12)
    # A quarter turn of the first joint turns everything about z.
    T = panda.forward_kinematics(np.array([np.pi / 2, 0, 0, 0, 0, 0, 0]))
    np.testing.assert_allclose(T[:3, 3], [0, 0.088, 0.926], atol=1e-12)


def test_ik_reaches_targets_with_orientation_held():
    ik = panda.CartesianIK()
    home = panda.forward_kinematics(panda.HOME_JOINTS)
    goal = home[:3, 3].copy()
    rng = np.random.default_rng(1)
    for _ in range(150):  # the fastest walk that the action allows, corner to corner
        goal = np.clip(goal + rng.choice([-1, 1], 3) * 0.1 * DT, [0.3, -0.2, 0.2], [0.66, 0.2, 0.59])
        q = ik.solve(goal)
        T = panda.forward_kinematics(q)
        np.testing.assert_allclose(T[:3, 3], goal, atol=1e-6)
        np.testing.assert_allclose(T[:3, :3], home[:3, :3], atol=1e-6)


def test_ik_stays_within_joint_limits_where_the_goal_is_out_of_reach():
    ik = panda.CartesianIK()
    for x in np.arange(0.3, 1.5, 0.007):
        q = ik.solve(np.array([x, 0.0, 0.3]))
        assert np.all(q >= JOINT_LOW) and np.all(q <= JOINT_HIGH)
    assert np.isfinite(q).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_simulated_flange_follows_the_commanded_velocity(axis):
    world = World("switch", touch="none")
    world.reset(0)
    rotation = world.data.site("flange").xmat.copy()
    start = world.flange_m
    velocity = np.zeros(4)
    velocity[axis] = -0.05 if axis == 0 else 0.05
    for _ in range(15):
        world.step(velocity)
    moved = world.flange_m - start
    # The servo lags by 20 ms, 1 mm at this speed; gravity and the finger's wobble add tenths.
    expected = velocity[:3] * 15 * DT
    np.testing.assert_allclose(moved, expected, atol=2.0e-3)
    for _ in range(10):
        world.step(np.zeros(4))
    np.testing.assert_allclose(world.flange_m - start, expected, atol=3e-4)
    np.testing.assert_allclose(world.data.site("flange").xmat, rotation, atol=2e-3)
