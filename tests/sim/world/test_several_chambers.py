"""A body of three chambers in the world: where it goes, how it gives way, and what it is refused."""

import mujoco
import numpy as np
import pytest
from arms import arm_twin
from gymnasium.utils.env_checker import check_env
from played import succeeds, until

from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.features import Places
from pneutac_sim.finger.equilibrium import solve
from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.twin import Value
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.expert import towards_gel
from pneutac_sim.world.spine import end_of
from pneutac_sim.world.world import World

SIX = arm_twin(angle_rad=0.35, gains=(0.9, 1.2))


@pytest.fixture(scope="module")
def world():
    return World("button", SIX, touch="area")


def hold(world, pressures_kpa, steps=40):
    for _ in range(steps):
        world.step([0, 0, 0, *pressures_kpa])


PRESSURES = [(40, 0, 0), (0, 45, 20), (20, 40, 10)]


@pytest.mark.parametrize("pressures_kpa", PRESSURES)
def test_the_free_tip_is_where_the_pipeline_has_it(world, pressures_kpa):
    """To 0.01 mm and 1e-4 rad, in both planes: the same joints on another path of code."""
    world.reset(0)
    pipeline = PressurePipeline(SIX)
    hold(world, pressures_kpa)
    for _ in range(40):
        joints = pipeline.step(np.array(pressures_kpa, float), world.dt_s)
    expected = pipeline.place(joints, world.dt_s)
    assert np.hypot(*expected[1:3]) > 8.0, "it bends"
    np.testing.assert_allclose(world.tip[:3], expected[:3], atol=0.01)
    np.testing.assert_allclose(world.tip[3:], expected[3:], atol=1e-4)
    np.testing.assert_allclose(world.spine_rad, joints, atol=1e-4)
    # the gel is on the side of +z of the last link, without a turn about the arm's axis
    base, gel = (world.data.body(n).xmat.reshape(3, 3) for n in ("finger", "sensor"))
    np.testing.assert_allclose(base.T @ gel, end_of(joints), atol=1e-4)


def test_each_chamber_bends_it_to_its_own_side_of_the_table(world):
    """Finger +z is world +x and finger +y world +y, as it hangs; chamber 1 pulls to 0.35 rad between them."""
    for chamber in range(3):
        world.reset(0)
        start = world.data.site("tip").xpos.copy()
        hold(world, np.eye(3)[chamber] * 30.0)
        x, y, z = world.data.site("tip").xpos - start
        angle = 0.35 + 2 * np.pi / 3 * chamber
        assert np.angle(np.exp(1j * (np.arctan2(y, x) - angle))) == pytest.approx(0.0, abs=0.01)
        assert np.hypot(x, y) > 0.03 and z > 0.005


def test_a_load_across_the_tip_bends_it_as_the_pipeline_says():
    world = World("button", arm_twin(), touch="none")
    world.reset(0)
    force, links = np.array([0.0, 0.15, 0.1]), np.append(np.full(5, 0.1 / 6), 0.1 / 12)
    q = np.zeros((1, 12))
    solve(q, np.array([[*force, 0, 0, 0]], float), 0.458, np.append(links, links / 0.1), np.zeros(12))
    tip, base = world.data.site("tip"), world.data.body("finger")
    for _ in range(120):
        moment, body = np.zeros(world.model.nv), world.model.body("sensor").id
        pull = base.xmat.reshape(3, 3) @ force
        mujoco.mj_applyFT(world.model, world.data, pull, np.zeros(3), tip.xpos, body, moment)
        world.data.qfrc_applied[:] = moment
        hold(world, (0, 0, 0), steps=1)
    assert np.abs(q).max() > 0.02
    np.testing.assert_allclose(world.spine_rad, q.reshape(6, 2), atol=5e-4)


ASKEW = {"pitch_rad": Value(0.05), "yaw_rad": Value(-0.04), "roll_rad": Value(0.06), "shift_y_mm": Value(2.0)}


@pytest.mark.parametrize("effect", ["base_tilt", "gravity", "creep"])
def test_effects_of_the_twin_act_in_both_planes(effect):
    twin = arm_twin(angle_rad=0.35)
    twin.effects[effect] = get_effect(effect).start(50.0) | (ASKEW if effect == "base_tilt" else {})
    world = World("button", twin, touch="none")
    world.reset(0)
    pipeline = PressurePipeline(twin, world.conditions)
    for _ in range(30):
        world.step([0, 0, 0, 30, 25, 0])
        joints = pipeline.step(np.array([30.0, 25.0, 0.0]), world.dt_s)
        expected = pipeline.place(joints, world.dt_s)
    plain = PressurePipeline(arm_twin(angle_rad=0.35))
    for _ in range(30):
        other = plain.place(plain.step(np.array([30.0, 25.0, 0.0]), world.dt_s), world.dt_s)
    assert np.abs(expected - other).max() > 0.01, "it does something"
    np.testing.assert_allclose(world.tip[:3], expected[:3], atol=0.05)
    np.testing.assert_allclose(world.tip[3:], expected[3:], atol=1e-3)


def test_the_environment_is_sized_by_the_chambers():
    env = PneutacEnv("button", twin=SIX)
    check_env(env, skip_render_check=True)
    assert env.action_space.shape == (6,) and env.observation_space["agent_pos"].shape == (22,)
    assert env.action_space.high[3:] == pytest.approx(50.0)
    env.reset(seed=0)
    for _ in range(20):
        state = env.step(np.array([0, 0, 0, 10, 20, 30], np.float32))[0]["agent_pos"]
    assert state[Places.of(3).pressure] == pytest.approx([10, 20, 30])
    assert state[Places.of(3).ee] == pytest.approx(env.world.flange_m, abs=1e-6)
    env.close()


def test_an_action_of_one_chamber_is_refused(world):
    with pytest.raises(InputError, match=r"\(4,\); it must be \(6,\): dx, dy, dz in m/s, 3 pressures in kPa"):
        world.step([0, 0, 0, 5])


@pytest.mark.parametrize("angle_rad", [0.7, -2.0])
@pytest.mark.parametrize("far_kpa", [50.0, -40.0])
def test_the_expert_bends_it_towards_the_gel_alone(angle_rad, far_kpa):
    twin = arm_twin(angle_rad, gains=(0.8, 1.1))
    full, reach_rad = towards_gel(twin, far_kpa)
    share = full / far_kpa
    assert share.min() >= 0 and share.max() == pytest.approx(1.0) and np.count_nonzero(share > 1e-6) <= 2
    joints = PressurePipeline(twin).step(full, 1.0)
    assert joints[:, 1] == pytest.approx(0.0, abs=1e-9)
    assert joints[:, 0].sum() == pytest.approx(reach_rad) and reach_rad > 0.6


def test_chambers_that_cannot_bend_it_towards_the_gel_are_refused():
    twin = arm_twin(1.0)
    for chamber in (2, 3):  # all three pull to the same side
        twin.parameters[f"chamber_{chamber}_turn_rad"] = Value(-2 * np.pi / 3 * (chamber - 1))
    with pytest.raises(InputError, match="No pressures of the twin's chambers bend it towards its gel"):
        towards_gel(twin, 50.0)


@pytest.mark.parametrize(("task", "angle_rad"), [("button", 0.7), ("switch", 0.35), ("egg", 0.0)])
def test_the_scripted_expert_does_the_task(task, angle_rad):
    twin = arm_twin(angle_rad, joint_stiffness_nm_per_rad=0.76)  # E I / h as of the paper's finger
    world = World(task, twin, touch="area")
    assert all(succeeds(world, seed) for seed in (2, 4))


def test_it_is_pressed_as_deep_as_its_springs_and_the_gels_say():
    """The force on the gel is that of its material, and the balls' springs bear it about both axes."""
    twin = arm_twin(angle_rad=0.35)
    world = World("button", twin, touch="area")
    until(world, 3, lambda: world.time_s > 5.3)
    hold(world, world.command[3:], steps=30)
    force = np.zeros(6)
    pull = np.zeros((6, 3))
    data, model = world.data, world.model
    places = data.xanchor[[model.joint(f"spine_{n + 1}").id for n in range(6)]]
    total = 0.0
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        contact = data.contact[i]
        sign = 1 if model.geom_group[contact.geom2] == 3 else -1
        on_finger = sign * contact.frame.reshape(3, 3).T @ force[:3]
        pull += np.cross(contact.pos - places, on_finger)
        total += force[0]
    assert 0.2 < total < 4.0 and world.press_n == pytest.approx(total, rel=0.1)
    for n in range(6):
        link = data.body(f"spine_{n + 1}").xmat.reshape(3, 3)
        to_z, to_y = world.spine_rad[n] - world.spine_target_rad[n]
        _, y, z = link.T @ pull[n]
        assert (-y, z) == pytest.approx((0.458 * to_z, 0.458 * to_y), abs=0.03 * np.abs(pull).max())
