"""The world: determinism, observations, bad input, clipping, pictures.

Substeps in one call are those of a loop.

Touch as data: displacement and force on a grid of the gel's face.

Worlds of other control rates are the same world; latency of a varied world: the same physics, later.
"""

import gymnasium
import mujoco
import numpy as np
import pytest
from arms import arm_twin
from played import played, until

import pneutac_sim  # noqa: F401  registers the environments
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, N_PIXELS, POINTS_SHAPE, STATE_NAMES
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin
from pneutac_sim.world import scene, view
from pneutac_sim.world.base import Variation
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.soft_finger import GEL_FRICTION
from pneutac_sim.world.station import Station
from pneutac_sim.world.task_env import contact_force_n, tactile_points
from pneutac_sim.world.tasks.base import HOME_JITTER_M
from pneutac_sim.world.view import CAMERA
from pneutac_sim.world.world import Substeps, World

DT = Station().dt_s


@pytest.fixture(scope="module")
def world():
    return World("switch", touch="image")


def rollout(world, seed, steps=30):
    states = [world.reset(seed).state]
    rng = np.random.default_rng(seed)
    low, high = (
        np.maximum(ACTION_LOW, [-0.03, -0.03, -0.05, 0]),
        np.minimum(ACTION_HIGH, [0.1, 0.03, 0.03, 15]),
    )
    images = []
    for _ in range(steps):
        o = world.step(rng.uniform(low, high))
        states.append(o.state)
        images.append(o.tactile)
    return np.array(states), np.array(images)


def test_same_seed_is_bitwise_the_same_also_in_another_instance(world):
    first, images = rollout(world, 7)
    rollout(world, 8)  # whatever happened before does not matter
    again, images_again = rollout(world, 7)
    other, images_other = rollout(World("switch", touch="image"), 7)
    for states in (again, other):
        assert np.array_equal(first, states)
    assert np.array_equal(images, images_again) and np.array_equal(images, images_other)


def test_seeds_differ_and_an_unseeded_reset_draws_the_next_start(world):
    starts = []
    for seed in (1, None, 2):
        world.reset(seed)
        starts.append(world.model.body("switch").pos.copy())
    assert not np.array_equal(starts[0], starts[1]) and not np.array_equal(starts[0], starts[2])
    world.reset(1)
    world.reset()
    assert np.array_equal(world.model.body("switch").pos, starts[1])


def test_touch_modes_agree_on_state_but_for_the_touch():
    worlds = {mode: World("switch", touch=mode) for mode in ("image", "area", "probe", "none")}
    states = {mode: rollout(world, 3, steps=20)[0] for mode, world in worlds.items()}
    assert np.array_equal(states["image"], states["area"])
    assert np.array_equal(worlds["area"].touch.depth_mm, worlds["probe"].touch.depth_mm)
    blind = [i for i, n in enumerate(STATE_NAMES) if not n.startswith("contact")]
    assert np.array_equal(states["image"][:, blind], states["none"][:, blind])


def test_observation_holds_what_the_names_say(world):
    observation = world.reset(0)
    for _ in range(4):
        observation = world.step([0.05, 0, 0, 9.0])
    state = dict(zip(STATE_NAMES, observation.state, strict=True))
    assert observation.state.dtype == np.float32 and observation.tactile.shape == (320, 240, 3)
    np.testing.assert_allclose([state[f"ee_{a}.pos"] for a in "xyz"], world.flange_m, atol=1e-6)
    np.testing.assert_allclose([state[f"joint_{i}.vel"] for i in range(1, 8)], world.data.qvel[:7], atol=1e-6)
    assert state["pressure.pos"] == pytest.approx(9.0)
    assert world.time_s == pytest.approx(4 * DT)
    s = world.touch.pixels
    assert state["contact_area.pos"] == pytest.approx(s / N_PIXELS)
    assert state["contact_pixels.pos"] == pytest.approx(np.log1p(s), abs=1e-5)


def test_limits_clip_and_count(world):
    world.reset(0)
    world.step([0, 0, 0, 15.0])
    world.step(ACTION_HIGH)
    world.step(ACTION_LOW)
    assert world.clipped == 0
    world.step([0, 0, 0, 40.0])
    assert world.clipped == 1 and world.pressure_kpa == 15.0
    world.step([0, 0, 0, -3.0])
    assert world.clipped == 2 and world.pressure_kpa == 0.0
    world.step([3.0, 0, 0, 0])
    assert world.clipped == 3 and world.command[0] == pytest.approx(0.1)
    for _ in range(90):
        world.step([0, 0, 0.1, 0])
    assert world.flange_m[2] <= world.station.workspace_high_m[2] + 2e-3
    assert world.clipped > 3


@pytest.mark.parametrize(
    "action", [[0, 0, np.nan, 5], [0, 0, 0, np.inf], [0, 0, 5], [[0, 0, 0, 5]], ["a"] * 4]
)
def test_bad_actions_are_one_clear_sentence(world, action):
    world.reset(0)
    before = world.data.qpos.copy()
    with pytest.raises(InputError, match="action") as e:
        world.step(action)
    assert str(e.value).count("\n") == 0
    assert np.array_equal(before, world.data.qpos)


THERMAL = Twin.builtin()
THERMAL.effects["thermal"] = get_effect("thermal").start(15.0)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"task": "door"}, "switch, egg, card"),
        ({"touch": "smell"}, "image, area, probe, none"),
        ({"render": "oil"}, "mesh, splats"),
        ({"twin": Twin(device="gel")}, "finger"),
        *(({"twin": arm_twin(), "fidelity": f}, "arm has 3, so give fi") for f in ("surrogate", "mpm")),
        ({"twin": arm_twin(), "sideways": True}, "has 3 chambers"),
        ({"conditions": {"temprature_c": 30.0}}, "'temprature_c'; did you mean 'temperature_c'"),
        *(
            (
                {"twin": THERMAL, "conditions": {"temperature_c": c}},
                "temperature_c: .* finite number, or a range",
            )
            for c in ([30.0, 20.0], "warm", float("nan"), True)
        ),
    ],
)
def test_what_there_is_no_world_of_is_named(options, says):
    with pytest.raises(InputError, match=says):
        World(**options)


@pytest.mark.parametrize("control_hz", [5, 15, 20, 60])
def test_time_step_divides_the_control_step_and_is_no_longer_than_the_papers(control_hz):
    world = World("switch", touch="none", station=Station(control_hz=control_hz))
    step = world.model.opt.timestep
    assert step * scene.substeps(control_hz) == pytest.approx(1 / control_hz, rel=1e-12)
    assert 0.9 / 750 < step <= 1 / 750 + 1e-12


def test_render_shows_the_scene_with_the_tactile_image(world):
    world.reset(0)
    free = world.render(320, 240)
    assert free.shape == (240, 320, 3) and free.dtype == np.uint8 and free.std() > 20
    until(world, 1, lambda: world.touch.pixels >= 2000)
    inset = (slice(-94, -8), slice(-72, -8))
    assert np.abs(world.render(320, 240)[inset].astype(int) - free[inset]).max() > 25


def test_without_opengl_the_scene_is_drawn(world, monkeypatch, caplog):
    def no_gl(*args):
        raise RuntimeError("no EGL here")

    monkeypatch.setattr("pneutac_sim.world.view.Renderer", no_gl)
    blind = World("switch", touch="none")
    blind.reset(0)
    first = blind.render(320, 240)
    assert "no EGL here" in caplog.text and not blind.renders_with_gl
    for _ in range(15):
        blind.step([0.05, 0, 0, 15.0])
    second = blind.render(320, 240)
    assert first.shape == (240, 320, 3) and first.std() > 20
    assert (first != second).any(axis=2).mean() > 0.02  # the finger has moved
    assert np.array_equal(second, view.draw(blind.model, blind.data, CAMERA, 320, 240))


def test_diverged_physics_is_no_fresh_scene():
    world = World("switch", touch="none", fidelity="probe")
    world.data.qvel[0] = 1e12
    with pytest.raises(InputError, match="physics has diverged: .*train finer networks"):
        world.step([0.0, 0.0, 0.0, 0.0])
    world.reset(0)
    world.step([0.0, 0.0, 0.0, 0.0])


def test_one_call_is_the_loop_bit_for_bit():
    world = World("egg", touch="none")
    model, one = world.model, world.data
    for _ in range(3):  # moving, so that a warm start matters
        world.step(np.array([0.1, 0.0, -0.1, 20.0]))
    many = mujoco.MjData(model)
    mujoco.mj_copyData(many, model, one)
    for data in (one, many):  # pushed from outside, as tests and users of the world do
        data.qfrc_applied[7], data.xfrc_applied[-1, :3] = 0.01, (0.0, 0.02, 0.0)
    ctrl = one.ctrl + np.linspace(0, 0.01, 50)[:, None]
    Substeps(model, one).run(ctrl)
    for row in ctrl:
        many.ctrl[:] = row
        mujoco.mj_step(model, many)
    for name in ("time", "qpos", "qvel", "qacc_warmstart", "ctrl", "xpos", "qfrc_applied", "xfrc_applied"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))


@pytest.fixture(scope="module")
def pressed() -> World:
    """A world whose gel presses the switch, some way in."""
    world = World("switch", touch="area")
    until(world, 2, lambda: world.press_n > 0.4)
    return world


def test_forces_sum_to_the_one_of_the_gels_spring(pressed):
    total = tactile_points(pressed)[..., 3:].sum((0, 1))
    np.testing.assert_allclose(total, contact_force_n(pressed.model, pressed.data), rtol=1e-5)
    assert total[2] == pytest.approx(-pressed.press_n, rel=0.05)
    # It slides: Coulomb's limit, but for the round bar's normal, which is not quite the gel's.
    assert np.abs(total[:2]).max() < 1.01 * GEL_FRICTION * abs(total[2])


def test_the_environment_has_them_where_asked_for():
    env = gymnasium.make("pneutac_sim/switch", touch="area", fidelity="probe", points=True)
    observation, _ = env.reset(seed=2)
    assert env.observation_space.contains(observation)
    assert observation["tactile.points"].size == np.prod(POINTS_SHAPE)
    with pytest.raises(InputError, match="no tactile points with touch 'none'"):
        gymnasium.make("pneutac_sim/switch", touch="none", points=True)


HELD_S = 0.2  # of each command: whole control steps at all of these rates


def free_way(control_hz):
    """Flange (n, 3) in mm, tip (n, 3) in mm and pressure (n,) after each of some commands in free air."""
    world = World("switch", touch="probe", station=Station(control_hz=control_hz))
    world.variation = Variation(shift_m=(0.0, 0.0, -5.0))
    world.reset(3)
    rng, rows = np.random.default_rng(0), []
    for _ in range(15):
        action = np.append(rng.uniform(-0.05, 0.05, 3), rng.uniform(2, 12))
        for _ in range(world.station.steps(HELD_S)):
            world.step(action)
        rows.append([*1e3 * world.flange_m, *world.tip[:3], world.pressure_kpa])
    assert world.time_s == pytest.approx(15 * HELD_S)
    return np.array(rows)


@pytest.mark.parametrize("control_hz", [5, 10, 30, 60])
def test_the_free_finger_goes_the_same_way_in_seconds(control_hz):
    at_15, other = free_way(15), free_way(control_hz)
    assert np.ptp(at_15[:, 5]) > 10  # mm: the finger bends
    np.testing.assert_allclose(other[:, :6], at_15[:, :6], atol=0.1)  # mm
    np.testing.assert_allclose(other[:, 6], at_15[:, 6], atol=1e-9)


def play(actions, **late):
    """States (T, 20) and contact areas (T,) of actions (T, 4)."""
    world = World("switch", touch="area", fidelity="probe")
    world.variation = Variation(**late)
    world.reset(3)
    states = [world.step(a).state for a in actions]
    return np.array(states), world


def demonstration():
    return played(World("switch", touch="area", fidelity="probe"), 3, steps=200)[1]


def test_latency_shifts_commands_and_touch_and_nothing_else():
    actions = demonstration()
    waiting = np.vstack([np.zeros((1, 4)), actions[:-1]])
    prompt, _ = play(waiting)
    late, world = play(actions, late_commands=1)
    np.testing.assert_array_equal(late, prompt)
    np.testing.assert_allclose(world.command, actions[-1], atol=1e-7)  # what was sent, as others record it
    touch = slice(17, 19)
    assert prompt[:, 17].max() > 0.01
    felt, _ = play(waiting, late_touch=1)
    np.testing.assert_array_equal(felt[1:, touch], prompt[:-1, touch])
    rest = np.delete(np.arange(20), np.r_[touch])
    np.testing.assert_array_equal(felt[:, rest], prompt[:, rest])


def test_plans_feel_with_the_gel_of_the_world():
    """A rollout in contact goes on where the world is, with its network, from whichever start."""
    world = World("egg", touch="area", fidelity="surrogate")
    gantry, formula = Gantry(world), TactileSensor(world.twin)
    by_formula, ahead = [], []
    for seed in range(1, 9):
        action = until(world, seed, lambda: world.touch.area > 0.005 or world.time_s > 10)
        gantry.mirror(world)
        felt = gantry.touch.depth_mm
        assert gantry.touch.area == pytest.approx(world.sensor.contact_from_depth(felt).area, abs=1e-6)
        by_formula.append(abs(formula.contact_from_depth(felt).area - gantry.touch.area))
        _, area = gantry.rollout(np.tile(action, (2, 1)))
        np.testing.assert_array_equal(gantry.rollout(np.tile(action, (2, 1)))[1], area)
        world.step(action)
        ahead.append(abs(area[0] - world.touch.area))
    assert np.median(by_formula) > 1e-3, "formula and network differ here"
    # The arm does not hold its orientation quite as the gantry does.
    assert np.median(ahead) < 2e-3


def test_after_a_shifted_start_the_tasks_own_home_is_home_again():
    """Who takes the last start as home lets starts wander from one reset to the next."""
    world = World("card", touch="none", fidelity="probe")
    own = world.home_m
    world.variation = Variation(start_m=tuple(own + (0.02, -0.01, 0.03)))
    world.widen_starts(1.0)  # of the objects alone
    for seed in range(8):
        world.reset(seed)
        assert (np.abs(world.target_m - own - (0.02, -0.01, 0.03)) <= HOME_JITTER_M).all()
    assert world.task.spread_x_m == pytest.approx(0.052)
    world.widen_starts(0.0)
    np.testing.assert_allclose(world.home_m, own + (0.02, -0.01, 0.03))
    world.variation = Variation()
    np.testing.assert_array_equal(world.home_m, own)
    world.reset(1)
    np.testing.assert_array_equal(world.home_m, own)
    assert np.abs(world.flange_m - own).max() < 0.01
