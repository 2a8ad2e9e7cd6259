"""The finger in the world: statics against the formula, loads, imprint and force.

The world with fingers of other labs: of any size, number of joints, stiffness and range of pressures.

A finger that a load bends across its plane: where it goes freely, and how it turns under a drag.
"""

import logging

import mujoco
import numpy as np
import pytest
from arms import arm_twin

from lerobot_pneutac.verbs.design_motion import PRESS, carried_out, sideways
from pneutac_sim.features import ACTION_HIGH, CONTROL_HZ
from pneutac_sim.finger.stages import joint_command
from pneutac_sim.gel.force import GelForce
from pneutac_sim.gel.probe import probe_grid
from pneutac_sim.twin import PAPER_FINGER, Twin, Value
from pneutac_sim.world.base import Variation
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

DT = Station().dt_s


def hold(world, pressure_kpa, steps=45):
    for _ in range(steps):
        world.step([0, 0, 0, pressure_kpa])


@pytest.fixture(scope="module")
def world():
    return World("switch", touch="area")


@pytest.mark.parametrize("pressure_kpa", [0.0, 15.0])
def test_equilibrium_is_the_commanded_bend(world, pressure_kpa):
    world.reset(0)
    hold(world, pressure_kpa)
    profile = [PAPER_FINGER[k] for k in ("gain_rad_per_kpa", "gain_alpha", "gain_beta", "rest_pressure_kpa")]
    np.testing.assert_allclose(world.spine_rad, joint_command(pressure_kpa, *profile, 4), atol=1e-4)
    # total bend 4 G (p + p0), unit mean of the profile
    assert world.spine_rad.sum() == pytest.approx(4 * 0.01114 * (pressure_kpa + 10.7), abs=4e-4)


def test_payload_at_the_tip_balances_the_springs(world):
    world.reset(0)
    K, load = PAPER_FINGER["joint_stiffness_nm_per_rad"], np.array([0.2, 0.0, -0.3])
    body = world.model.body("spine_4").id
    world.data.xfrc_applied[body, :3] = load
    hold(world, 5.0, steps=60)
    world.data.xfrc_applied[:] = 0
    point = world.data.xipos[body]  # MuJoCo applies the force at the centre of mass
    for n in range(4):
        arm = point - world.data.xanchor[world.model.joint(f"spine_{n + 1}").id]
        torque = -np.cross(arm, load)[1]  # hinges turn about world -y
        spring = K * (world.spine_rad[n] - world.spine_target_rad[n])
        assert spring == pytest.approx(torque, abs=3e-4)


def test_weight_acts_where_the_twin_has_gravity(world):
    def sag(body_mass_g, tip_mass_g):
        twin = Twin.builtin()
        twin.effects["gravity"] = {"body_mass_g": Value(body_mass_g), "tip_mass_g": Value(tip_mass_g)}
        heavy = World("switch", twin, touch="none")
        heavy.reset(0)
        hold(heavy, 6.0)
        return free - heavy.spine_rad

    world.reset(0)
    hold(world, 6.0)
    free = world.spine_rad
    light, heavy = sag(20.0, 10.0), sag(40.0, 20.0)
    assert np.all(light > 1e-3)  # a hanging, curled finger is pulled straight
    assert light[0] == max(light)
    # The heavier finger curls a little less, so its arms shorten.
    np.testing.assert_allclose(heavy / light, 2.0, rtol=0.1)


def press_on_a_fixed_bar(push_m, twin=None):
    """Drives the gel into the bar of a locked switch by `push_m`; returns N, mm, mm and the world."""
    world = World("switch", twin, touch="area")
    world.reset(0)
    hold(world, 5.0)
    model, data = world.model, world.data
    bar = model.geom("bar").id
    normal = data.site("gel").xmat.reshape(3, 3)[:, 2]
    model.dof_damping[model.joint("lever").dofadr[0]] = 1e4
    touching = world.gel_m + normal * (model.geom_size[bar, 0] + 0.001)
    model.body_pos[model.body("switch").id] += touching - data.geom_xpos[bar]
    steps = 30
    for _ in range(steps):
        world.step([*(normal * push_m / (steps * DT)), 5.0])
    hold(world, 5.0, steps=20)
    total, force = 0.0, np.zeros(6)
    for i in range(data.ncon):
        assert model.geom("pad").id in (data.contact[i].geom1, data.contact[i].geom2)
        mujoco.mj_contactForce(model, data, i, force)
        total += force[0]
    return total, float(world.touch.depth_mm.max()), world.press_mm, world


@pytest.mark.parametrize("push_m", [0.01, 0.02])
def test_object_finger_and_gel_feel_the_force_of_the_gels_material(push_m):
    force, imprint_mm, press_mm, world = press_on_a_fixed_bar(push_m)
    assert 0.1 < force < 2.0
    assert world.press_n == pytest.approx(force, rel=0.05)
    law = GelForce.of(world.twin)
    objects = world.touch.objects(world.data)
    grid = probe_grid(*objects, window_mm=law.window_mm, thickness_mm=law.thickness_mm)
    assert law.force(grid) == pytest.approx(force, rel=0.10)
    # What the probe grid sees is the pad's imprint, plus the solver's softness of a few hundredths of a mm.
    assert imprint_mm == pytest.approx(press_mm, rel=0.05, abs=0.03)
    # The finger's springs bear the force: it acts where the bar is, along the gel's normal.
    bar, gel = world.data.geom("bar").xpos, world.data.site("gel").xmat.reshape(3, 3)
    arms = bar - world.data.xanchor[[world.model.joint(f"spine_{n + 1}").id for n in range(4)]]
    torque = -np.cross(arms, -force * gel[:, 2])[:, 1]  # hinges turn about world -y
    spring = PAPER_FINGER["joint_stiffness_nm_per_rad"] * (world.spine_rad - world.spine_target_rad)
    np.testing.assert_allclose(spring, torque, rtol=0.03)


@pytest.mark.parametrize("modulus_mpa", [0.005, 2.0])
def test_any_gel_comes_to_rest(modulus_mpa):
    twin = Twin.builtin()
    twin.parameters["gel_youngs_modulus_mpa"] = Value(modulus_mpa)
    force, _, press_mm, world = press_on_a_fixed_bar(0.02, twin)
    assert 0.02 < force < 3.0
    assert world.press_n == pytest.approx(force, rel=0.1)
    assert abs(world.data.joint("pad").qvel[0]) < 2e-3
    stiffer = press_on_a_fixed_bar(0.02)
    assert (press_mm > stiffer[2]) == (modulus_mpa < 0.1)


@pytest.mark.parametrize("chambers, length_mm, joints, stiffness", [
    (1, 40.0, 10, 50.0), (1, 160.0, 3, 0.05), (1, 250.0, 10, 0.458), (1, 250.0, 2, 5.0),
    (3, 60.0, 10, 50.0), (3, 250.0, 6, 5.0), (3, 100.0, 2, 0.1),
])  # fmt: skip
def test_any_body_is_stable_and_swings_less_and_less_after_a_push(chambers, length_mm, joints, stiffness):
    """Springs of MuJoCo alone run away where w h > 2: with these from 0.17 N m/rad a joint on."""
    twin = Twin.builtin() if chambers == 1 else arm_twin(joints=joints)
    twin.length_mm = length_mm
    twin.spine_joint_positions_mm = np.linspace(0.1, 0.9, joints) * length_mm
    twin.parameters["joint_stiffness_nm_per_rad"] = Value(stiffness)
    world = World("switch", twin, touch="none")
    world.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT  # the long ones reach the table
    world.reset(0)
    world.data.qvel[world._spine] = 3.0 if chambers == 1 else np.tile([1.0, 3.0, -2.0], joints)
    swing = []
    for _ in range(60):
        world.step([0, 0, 0, 5.0] if chambers == 1 else [0, 0, 0, 10, 0, 5])
        swing.append(np.abs(world.spine_rad - world.spine_target_rad).max())
    assert swing[0] < 2.0 and world.data.warning.number.sum() == 0
    assert max(swing[-10:]) < max(0.5 * max(swing[2:12]), 1e-4)


@pytest.mark.nightly
def test_the_finger_is_stable_for_an_hour_under_any_pressure_and_load():
    """Now and then a load leads far out of the training of the network, which is counted and passes."""
    world = World("switch", touch="none", fidelity="surrogate")
    world.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    world.reset(0)
    rng, pressure, largest = np.random.default_rng(0), 0.0, 0.0
    for k in range(int(3600 / DT)):
        if k % 7 == 0:
            pressure = rng.uniform(0.0, 15.0)
            wild = 8.0 if k % 700 == 0 else 1.0
            world.data.qfrc_applied[world._spine] = wild * rng.uniform(-0.05, 0.05, 4)
        world.step([0.0, 0.0, 0.0, pressure])
        largest = max(largest, np.abs(world.spine_rad - world.spine_target_rad).max())
    assert np.isfinite(largest) and largest < 2.0
    assert 0 < world.out_of_range < 0.1 * 3600 / DT
    world.data.qfrc_applied[:] = 0.0
    hold(world, 5.0, steps=60)
    np.testing.assert_allclose(world.spine_rad, world.spine_target_rad, atol=1e-4)


def finger(range_kpa=(0.0, 60.0)) -> Twin:
    """Of six joints, which bends by 0.9 rad in all from the rest to the farther end of its range."""
    parameters = dict(Twin.builtin().parameters)
    parameters["gain_rad_per_kpa"] = Value(0.9 / 6 / max(range_kpa, key=abs))
    parameters["rest_pressure_kpa"] = Value(0.0)
    at = [80.0 * (i + 0.5) / 6 for i in range(6)]
    return Twin("finger", 80.0, at, parameters, pressure_range_kpa=range_kpa)


@pytest.mark.parametrize("range_kpa", [(0.0, 60.0), (-40.0, 0.0), (-20.0, 30.0)])
def test_pressures_reach_as_far_as_the_twin_was_measured_and_no_farther(range_kpa, caplog):
    env = PneutacEnv("switch", "none", finger(range_kpa=range_kpa), "probe")
    low, high = range_kpa
    assert (env.action_space.low[3], env.action_space.high[3]) == range_kpa
    assert env.observation_space["agent_pos"].high[-1] == high
    env.reset(seed=0)
    far = max(range_kpa, key=abs)
    with caplog.at_level(logging.WARNING):
        for _ in range(6):
            info = env.step([0, 0, 0, far])[-1]
        assert info["clipped"] == 0 and not caplog.records
        assert env.world.pressure_kpa == pytest.approx(far)
        assert env.world.spine_rad.sum() == pytest.approx(0.9, abs=0.03)
        for _ in range(2):
            info = env.step([0, 0, 0, 2 * far])[-1]
    assert info["clipped"] == 2 and env.world.pressure_kpa == pytest.approx(far)
    assert len(caplog.records) == 1 and f"{low:g} to {high:g} kPa" in caplog.text  # told once, counted always
    asked = PneutacEnv("switch", "none", finger(range_kpa), "probe", pressure_range_kpa=(-80.0, 80.0))
    asked.reset(seed=0)
    for _ in range(6):
        info = asked.step([0, 0, 0, 4 / 3 * far])[-1]
    assert info["clipped"] == 0 and asked.world.spine_rad.sum() == pytest.approx(1.2, abs=0.03)


def test_the_same_bend_by_vacuum_and_by_four_times_the_pressure_does_the_task_alike():
    """An expert's pressures are shares of the range: a finger like the paper's but for its gain is alike."""
    ways = []
    for factor in (1.0, 4.0, -1.0):
        twin = Twin.builtin()
        for name, power in (("gain_rad_per_kpa", -1), ("rest_pressure_kpa", 1)):
            twin.parameters[name] = Value(twin.parameter(name) * factor**power)
        twin.pressure_range_kpa = tuple(sorted((0.0, 15.0 * factor)))
        world = World("switch", twin, "none")
        expert = ScriptedExpert(world, np.random.default_rng(1))
        world.reset(1)
        way = []
        for _ in range(4 * CONTROL_HZ):
            action = expert.action()
            world.step(action)
            way.append([*world.flange_m, *world.spine_rad, action[3] / factor])
        ways.append(way)
    assert np.ptp(np.array(ways[0])[:, -1]) > 1 and np.max(ways[0]) < ACTION_HIGH[3]
    for way in ways[1:]:
        np.testing.assert_allclose(way, ways[0], atol=1e-4)


@pytest.fixture(scope="module")
def sideways_world():
    return World("button", touch="none", sideways=True)


def drag(sideways_world, friction, drag_mm=12.0):
    sideways_world.variation = Variation(friction=friction)
    return carried_out(sideways_world, 3, sideways(drag_mm))


def test_pressure_bends_it_in_its_plane_as_ever(sideways_world):
    flat = World("button", touch="none")
    for w in (sideways_world, flat):
        w.reset(1)
        for _ in range(40):
            w.step([0, 0, 0, 9.0])
    np.testing.assert_allclose(sideways_world.tip, flat.tip, atol=0.01)
    np.testing.assert_allclose(sideways_world.spine_rad[:, 1], 0, atol=1e-4)


def test_a_gel_that_sticks_turns_by_three_halves_of_the_way_over_the_length(sideways_world):
    """A beam held at its end, whose tip is free to turn, however stiff; the gel's middle is 15 mm beyond."""
    felt = drag(sideways_world, friction=5.0)
    beam = np.degrees(1.5 / (sideways_world.twin.length_mm + 15.0))
    assert felt.turn_deg_per_mm == pytest.approx(beam, rel=0.15)
    softer = Twin.builtin()
    whole = softer.parameter("joint_stiffness_nm_per_rad")
    softer.parameters = softer.parameters | {"joint_stiffness_nm_per_rad": Value(0.7 * whole)}
    soft = World("button", softer, touch="none", sideways=True)
    assert drag(soft, friction=5.0).turn_deg_per_mm == pytest.approx(felt.turn_deg_per_mm, rel=0.1)
    sideways_world.variation = soft.variation = Variation()
    press, pressed = (carried_out(w, 3, PRESS).force_n.mean() for w in (sideways_world, soft))
    assert pressed == pytest.approx(0.75 * press, rel=0.1)


def test_one_that_slips_turns_less(sideways_world):
    turns = [drag(sideways_world, friction).turn_deg_per_mm for friction in (5.0, 0.3, 0.05)]
    assert turns[0] > turns[1] > turns[2] and turns[2] < 0.3 * turns[0]
    assert carried_out(sideways_world, 3, PRESS).turn_deg_per_mm == 0
