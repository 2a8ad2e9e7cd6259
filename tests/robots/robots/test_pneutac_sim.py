"""Tests of the starts that a few demonstrations are spread over."""

import logging
import re

import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.cameras.opencv import OpenCVCameraConfig
from lerobot.rollout.context import HardwareContext
from lerobot.rollout.strategies import core
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from sensors import wide_twin

from lerobot_robot_pneutac.cameras.simulated import PneutacSceneConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import HOME_RADIUS_M, PneutacSim, SpreadStarts
from lerobot_robot_pneutac.standin.world import GelTouch, StandinWorld
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH, ACTION_NAMES, CONTROL_HZ, STATE_NAMES
from pneutac_sim.twin import Twin
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.touch import Touch

EE = ("ee_x.pos", "ee_y.pos", "ee_z.pos")


@pytest.fixture
def make_robot(tmp_path):
    robots = []

    def make(**kwargs) -> PneutacSim:
        robots.append(PneutacSim(PneutacSimConfig(id="sim", calibration_dir=tmp_path, **kwargs)))
        robots[-1].connect()
        return robots[-1]

    yield make
    for robot in robots:
        if robot.is_connected:
            robot.disconnect()


def act(dx=0.0, dy=0.0, dz=0.0, pressure=0.0, **more) -> dict:
    return dict(zip(ACTION_NAMES, (dx, dy, dz, pressure), strict=True)) | more


def position(robot) -> np.ndarray:
    observation = robot.get_observation()
    return np.array([observation[name] for name in EE])


def test_features_are_known_before_connecting_and_survive_lerobot_rollout(tmp_path):
    robot = PneutacSim(PneutacSimConfig(id="sim", calibration_dir=tmp_path))
    assert robot.name == "pneutac"
    scalars = [k for k, v in robot.observation_features.items() if v is float]
    assert scalars == list(STATE_NAMES)
    assert list(robot.action_features) == list(ACTION_NAMES)
    # lerobot-rollout silently leaves out every scalar that ends otherwise.
    assert all(k.endswith((".pos", ".vel")) for k in [*scalars, *robot.action_features])
    assert robot.observation_features["tactile"] == (320, 240, 3)
    assert len(robot.cameras) == 1  # for each of which LeRobot writes PNG files by four threads


@pytest.mark.parametrize("options", [{"fidelity": "probe"}, {"standin": True}])
def test_the_tactile_image_has_the_size_of_the_twins_sensor(make_robot, tmp_path, options):
    robot = make_robot(twin=wide_twin().save(tmp_path / "twin"), **options)
    image = robot.get_observation()["tactile"]
    assert image.shape == robot.observation_features["tactile"] == (480, 640, 3)
    assert image.std() > 10


def test_scene_cameras_are_features_of_the_size_that_is_asked(make_robot):
    robot = make_robot(cameras={"front": PneutacSceneConfig(width=64, height=48)}, fidelity="probe")
    assert robot.observation_features["front"] == (48, 64, 3) and list(robot.cameras) == ["tactile", "front"]
    before = robot.get_observation()["front"]
    assert before.shape == (48, 64, 3) and before.dtype == np.uint8
    for _ in range(5):
        robot.send_action(act(dy=0.1, pressure=9.0))
    assert (np.abs(robot.get_observation()["front"].astype(int) - before).max(-1) > 40).any()


def test_a_real_camera_cannot_see_the_scene():
    real = OpenCVCameraConfig(index_or_path=0, width=640, height=480, fps=30)
    with pytest.raises(DecodingError, match="'front' is of type opencv at 30 fps; the simulated robot has"):
        PneutacSimConfig(cameras={"front": real})


def test_an_action_moves_the_flange_by_its_velocity_for_a_control_step(make_robot):
    robot = make_robot()
    start = position(robot)
    for _ in range(15):
        robot.send_action(act(dy=0.04, pressure=3.0))
    assert position(robot) - start == pytest.approx([0, 0.04, 0], abs=0.003)
    assert robot.get_observation()["pressure.pos"] == pytest.approx(3.0)


def test_actions_are_clipped_and_the_sent_one_returned(make_robot):
    sent = make_robot().send_action(act(dx=9.0, dz=-0.01, pressure=99.0))
    assert sent == pytest.approx(act(dx=ACTION_HIGH[0], dz=-0.01, pressure=ACTION_HIGH[3]))


def test_bad_actions_are_named(make_robot):
    robot = make_robot()
    with pytest.raises(InputError, match="not finite"):
        robot.send_action(act(dx=float("nan")))
    with pytest.raises(InputError, match="the robot takes dx.vel, dy.vel, dz.vel, pressure.pos"):
        robot.send_action({"delta_x": 1.0})


def test_same_seed_same_starts_and_each_reset_another(make_robot):
    def starts(seed):
        robot = make_robot(seed=seed)
        found = [position(robot)]
        for _ in range(2):
            robot.send_action(act(dx=0.01, reset=True))
            found.append(position(robot))
        robot.disconnect()
        return np.array(found)

    first, again, other = starts(1), starts(1), starts(2)
    assert (first == again).all()
    assert np.linalg.norm(first[0] - first[1]) > 1e-4
    assert np.linalg.norm(first[1] - first[2]) > 1e-4
    assert np.linalg.norm(first[0] - other[0]) > 1e-4


def test_lerobots_return_to_the_start_brings_a_fresh_scene_once(make_robot, monkeypatch):
    robot = make_robot()
    initial = {k: v for k, v in robot.get_observation().items() if k.endswith(".pos")}
    start = position(robot)
    for _ in range(15):
        robot.send_action(act(dy=0.08, pressure=5.0))
    assert np.linalg.norm(position(robot) - start) > 0.05
    monkeypatch.setattr(core, "precise_sleep", lambda _: None)
    hardware = HardwareContext(robot_wrapper=robot, teleop=None, initial_position=initial)
    core.RolloutStrategy._return_to_initial_position(hardware, duration_s=1)
    assert np.linalg.norm(position(robot) - robot.world.task.home_m) < HOME_RADIUS_M
    assert robot.successes == [False]
    core.RolloutStrategy._return_to_initial_position(hardware, duration_s=1)
    assert robot.successes == [False]


def test_connection_is_checked(tmp_path, make_robot):
    robot = PneutacSim(PneutacSimConfig(id="sim", calibration_dir=tmp_path))
    for call in (robot.get_observation, robot.disconnect, lambda: robot.send_action(act())):
        with pytest.raises(DeviceNotConnectedError):
            call()
    with pytest.raises(DeviceAlreadyConnectedError):
        make_robot().connect()


def test_bad_options_are_named(tmp_path):
    with pytest.raises(DecodingError, match="'juggle'; it must be one of switch, egg, card"):
        PneutacSimConfig(task="juggle")
    with pytest.raises(DecodingError, match="holds no twin.yaml"):
        PneutacSimConfig(twin=tmp_path)


def test_the_standin_acts_late_and_has_no_twin(make_robot, tmp_path):
    robot = make_robot(standin=True)
    assert isinstance(robot.world, StandinWorld)
    start = position(robot)
    sent = robot.send_action(act(dy=0.1, pressure=5.0))
    assert sent == pytest.approx(act(dy=0.1, pressure=5.0))
    assert position(robot) == pytest.approx(start, abs=1e-3)
    for _ in range(3):
        robot.send_action(act(pressure=5.0))
    assert position(robot)[1] - start[1] == pytest.approx(0.1 / CONTROL_HZ, abs=1e-3)
    with pytest.raises(DecodingError, match="leave --robot.fidelity, --robot.conditions,"):
        PneutacSimConfig(standin=True, fidelity="mpm")


def test_conditions_reach_the_robots_world_and_its_session_goes_on(make_robot, tmp_path):
    twin = Twin.builtin()
    for name in ("thermal", "p exp(-t)"):
        twin.effects[name] = get_effect(name).start(15.0)
    twin.effects["p exp(-t)"]["weight"].value = 0.3
    twin.save(tmp_path / "twin")
    options = {"twin": tmp_path / "twin", "fidelity": "probe"}
    with pytest.raises(DecodingError, match="robot.conditions: The twin's effect 'thermal' needs"):
        PneutacSimConfig(**options)
    with pytest.raises(DecodingError, match="leave --robot.fidelity, --robot.conditions, --robot.render"):
        PneutacSimConfig(standin=True, conditions={"temperature_c": 30.0})
    robot = make_robot(**options, conditions={"temperature_c": 30.0})
    assert robot.world.conditions["temperature_c"] == 30.0
    bends = []
    for _ in range(2):
        for _ in range(60):
            robot.send_action(act(pressure=10.0))
        bends.append(robot.world.spine_target_rad.sum())
        robot.reset()
    assert bends[1] < bends[0] - 1e-3, "it has warmed up further by the second episode"


def test_each_episode_says_how_it_went(make_robot, caplog):
    robot = make_robot(task="fruit", fidelity="probe")
    with caplog.at_level(logging.INFO, "lerobot_robot_pneutac"):
        for _ in range(5):
            robot.send_action(act())
        robot.reset()
        expert = ScriptedExpert(robot.world, np.random.default_rng(0))
        frames = 0
        while not robot.world.success and frames < 200:
            robot.send_action(dict(zip(ACTION_NAMES, expert.action().tolist(), strict=True)))
            frames += 1
        robot.reset()
    first, second = (r.getMessage() for r in caplog.records if "Touch in" in r.getMessage())
    assert first == "Touch in 0 of 5 frames; the task is not done."
    assert re.fullmatch(rf"Touch in [1-9]\d* of {frames} frames; the task is done\.", second)


@pytest.mark.parametrize(("touch", "standin"), [(Touch, False), (GelTouch, True)])
def test_a_touch_is_drawn_while_connecting(touch, standin, monkeypatch, make_robot):
    drawn, prepare = [], touch.prepare
    monkeypatch.setattr(touch, "prepare", lambda self: drawn.append(prepare(self)))
    make_robot(task="button", standin=standin)
    assert len(drawn) == 1


def mean_distance_to_nearest(points, chosen):
    return np.linalg.norm(points[:, None] - points[chosen][None], axis=-1).min(1).mean()


def test_ten_chosen_starts_stand_for_all_better_than_ten_random_ones():
    rng = np.random.default_rng(0)
    points = rng.uniform(size=(200, 2))
    starts = SpreadStarts({k: np.append(p, 0.0)[None] for k, p in enumerate(points)})
    chosen = []
    for _ in range(10):
        chosen.append(starts.next())
        starts.done(chosen[-1])
    random = [mean_distance_to_nearest(points, rng.permutation(200)[:10]) for _ in range(500)]
    assert mean_distance_to_nearest(points, chosen) < np.quantile(random, 0.01)


def test_a_start_that_failed_is_not_begun_again_and_leaves_its_place_open():
    starts = SpreadStarts({7: np.zeros((1, 3)), 8: np.full((1, 3), 0.01), 9: np.ones((1, 3))})
    assert starts.next() == 8  # the middle of the two that are near
    assert starts.next() == 7  # failed: what is near to it is tried
    starts.done(7)
    assert starts.next() == 9
    starts.done(9)
    assert starts.next() == 8  # all were given


def test_the_robot_begins_in_every_lane():
    """Random starts of five episodes leave one of the three lanes out in four of ten cases."""
    robot = PneutacSim(PneutacSimConfig(id="spread", task="switch", standin=True, spread=40))
    robot.connect()
    begun = []
    for _ in range(5):
        begun.append(robot.world.flange_m[1])
        robot.world.task._rested_s = 9.0  # done
        robot.reset()
    robot.disconnect()
    assert set(np.round(np.array(begun) / 0.02)) == {-1.0, 0.0, 1.0}
