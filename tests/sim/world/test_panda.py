"""The arm: kinematics against the closed form, inverse kinematics, servo tracking.

Arms from a URDF or MJCF, six joints and five.
"""

import mujoco
import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.features import JOINT_HIGH, JOINT_LOW
from pneutac_sim.world import panda
from pneutac_sim.world.arms import ARMS, Chain
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.panda import HOME_JOINTS, forward_kinematics
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


def test_ik_stays_within_joint_limits_where_the_goal_is_out_of_reach():
    ik = panda.CartesianIK()
    for x in np.arange(0.3, 1.5, 0.007):
        q = ik.solve(np.array([x, 0.0, 0.3]))
        assert np.all(q >= JOINT_LOW) and np.all(q <= JOINT_HIGH)
    assert np.isfinite(q).all()


@pytest.mark.parametrize("axis", [0, 2])
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


UR5_A, UR5_D = (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0), (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823)
UR5_ALPHA = np.pi / 2 * np.array([1, 0, 0, 1, -1, 0])


def ur5_pose(q):
    """The flange by the standard Denavit-Hartenberg product of the published parameters, (4, 4)."""
    T = np.eye(4)
    for a, d, alpha, theta in zip(UR5_A, UR5_D, UR5_ALPHA, q, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return T


def chain(name, base_m=(0.0, 0.0, 0.0)):
    described = ARMS[name][0]
    return Chain(described.urdf, described.flange, described.home_rad, base_m)


def test_the_ur5_stands_where_its_published_parameters_say():
    ik = chain("ur5", (0.1, 0.2, 0.3)).solver()
    for q in np.random.default_rng(0).uniform(-3, 3, (5, 6)):
        rotation, position = ik.pose(q)
        np.testing.assert_allclose(position, ur5_pose(q)[:3, 3], atol=1e-7)
        np.testing.assert_allclose(rotation[:, 2], ur5_pose(q)[:3, 2], atol=1e-3)


@pytest.mark.parametrize(
    ("arm", "place_m", "turn"),
    [(panda.Panda(), 1e-6, 1e-6), (chain("ur5"), 1e-4, 0.02), (chain("so101"), 1e-4, 0.02)],
)
def test_the_flange_goes_where_it_is_sent_and_keeps_its_orientation(arm, place_m, turn):
    ik, rng = arm.solver(), np.random.default_rng(1)
    held, home = ik.pose(ik.q)
    np.testing.assert_allclose(held, forward_kinematics(HOME_JOINTS)[:3, :3], atol=1e-3)
    goal = home.copy()
    for _ in range(150):  # the fastest walk that the action allows, corner to corner
        goal = np.clip(goal + rng.choice([-1, 1], 3) * 0.1 * DT, home - 0.06, home + 0.06)
        rotation, position = ik.pose(ik.solve(goal))
        np.testing.assert_allclose(position, goal, atol=place_m)
        np.testing.assert_allclose(rotation, held, atol=turn)


@pytest.mark.parametrize("name", ["ur5", "so101"])
def test_by_how_much_a_place_is_out_of_reach_is_known(name):
    ik = chain(name).solver()
    ik.solve(ik.pose(ik.q)[1] + [2.0, 0.0, 0.0])
    assert ik.missing_m > 1


@pytest.mark.parametrize("arm", [panda.Panda(), chain("ur5")])
def test_several_arms_are_solved_as_each_alone(arm):
    goals = arm.solver().pose(arm.home_rad)[1] + np.random.default_rng(2).uniform(-0.05, 0.05, (3, 4, 3))
    many, alone = arm.solver(), [arm.solver() for _ in range(4)]
    many.reset(np.tile(arm.home_rad, (4, 1)))
    for at in goals:
        together, each = many.solve(at), [one.solve(p) for one, p in zip(alone, at, strict=True)]
        assert np.array_equal(together, each) and np.ptp(together, axis=0).max() > 0.01


@pytest.mark.parametrize("name", ["ur5", "so101"])
def test_the_jacobian_is_the_slope_of_the_pose(name):
    ik, h = chain(name).solver(), 1e-6
    q = ik.q + 0.1
    ik.pose(q)
    position, rotation = ik.jacobian()
    for j, step in enumerate(h * np.eye(len(q))):
        (R0, p0), (R1, p1) = ik.pose(q - step), ik.pose(q + step)
        np.testing.assert_allclose((p1 - p0) / (2 * h), position[:, j], atol=1e-6)
        turn = (R1 - R0) / (2 * h) @ ik.pose(q)[0].T
        np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], rotation[:, j], atol=1e-6)


@pytest.mark.parametrize(("name", "joints"), [("ur5", 6), ("so101", 5)])
def test_an_expert_does_its_task_and_the_state_has_the_arms_joints(name, joints):
    world = World("card", touch="area", station=Station(arm=name))
    observation = world.reset(0)
    assert observation.state.shape == (2 * joints + 6,)
    expert = ScriptedExpert(world, np.random.default_rng(0))
    while not world.success:
        observation = world.step(expert.action())
        assert world.time_s < 10
    # What is observed is in the arm's frame, and its joints are those of its own kinematics.
    rotation, position = world.arm.solver().pose(observation.state[:joints].astype(float))
    np.testing.assert_allclose(observation.state[-6:-3], position, atol=1e-5)
    np.testing.assert_allclose(world.flange_m - world.station.base_m, position, atol=1e-5)
    assert rotation[2, 2] < -0.999


def test_out_of_reach_the_arm_stays_and_comes_back():
    world = World("switch", touch="none", station=Station(arm="so101", workspace_high_m=(0.9, 0.2, 0.55)))
    for _ in range(60):
        world.step([0.1, 0.0, 0.0, 0.0])
    assert world.clipped > 10 and world.flange_m[0] < 0.6
    far = world.flange_m[0]
    for _ in range(5):
        world.step([-0.1, 0.0, 0.0, 0.0])
    assert world.flange_m[0] < far - 0.02


MJCF = """<mujoco><compiler meshdir="nowhere"/><asset><mesh file="link.obj"/></asset><worldbody>
<body name="foot"><geom type="mesh" mesh="link"/><joint name="a" axis="0 0 1"/>
<body pos="0 0 .3"><joint axis="0 1 0"/><body pos=".3 0 .1"><joint axis="0 1 0"/>
<body pos=".2 0 0"><joint axis="0 1 0"/><body pos="0 0 -.05"><joint axis="0 0 1"/>
<site name="tool" pos="0 0 -.05" euler="180 0 0"/></body></body></body></body></body>
</worldbody><actuator><position joint="a"/></actuator></mujoco>"""


def test_an_mjcf_without_its_meshes_is_an_arm_too(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(MJCF)
    arm = Chain(str(file), "tool", (0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(arm.solver().pose(arm.home_rad)[1], [0.5, 0.0, 0.3], atol=1e-9)
    assert mujoco.MjModel.from_xml_string(
        f"<mujoco><default><default class='arm'/></default><asset><material name='arm'/>"
        f"<material name='arm_dark'/></asset><worldbody>{arm.body()}</worldbody></mujoco>"
    ).nq == 5  # fmt: skip


def test_an_arm_that_cannot_reach_the_task_says_so():
    with pytest.raises(InputError, match="falls .* short .* where the task 'card' starts"):
        World("card", touch="none", station=Station(arm="so101", base_m=(0.0, 0.0, 0.0)))
