"""A body of three chambers as LeRobot sees it: robot, scripted teleoperator, environment, dataset."""

import numpy as np
import pytest
from arms import arm_twin
from draccus.utils import DecodingError
from lerobot.datasets import LeRobotDataset
from lerobot.envs.factory import make_env
from lerobot.envs.utils import env_to_policy_features, preprocess_observation

from lerobot_robot_pneutac.env import PneutacEnvConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.config_pneutac_scripted import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.record import record_episodes
from pneutac_sim.errors import InputError
from pneutac_sim.features import action_names, state_names

ACTIONS = ["dx.vel", "dy.vel", "dz.vel", "pressure_1.pos", "pressure_2.pos", "pressure_3.pos"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return arm_twin(0.35, joint_stiffness_nm_per_rad=0.76).save(tmp_path_factory.mktemp("arm"))


@pytest.fixture
def robot(folder):
    robot = PneutacSim(PneutacSimConfig(id="arm", task="button", twin=folder, fidelity="probe"))
    robot.connect()
    yield robot
    if robot.is_connected:
        robot.disconnect()


def test_the_robot_has_an_action_and_a_reading_of_each_chamber(robot):
    assert list(robot.action_features) == ACTIONS == list(action_names(3))
    assert tuple(robot.observation_features)[:-1] == state_names(7, 3)
    sent = robot.send_action(dict(zip(ACTIONS, [0.0, 0.0, 0.0, 10.0, 20.0, 99.0], strict=True)))
    assert [sent[f"pressure_{i}.pos"] for i in (1, 2, 3)] == [10.0, 20.0, 50.0]
    seen = robot.get_observation()
    assert [seen[f"pressure_{i}.pos"] for i in (1, 2, 3)] == pytest.approx([10.0, 20.0, 50.0])
    with pytest.raises(
        InputError, match="the keys dx.vel.*pressure.pos; the robot takes .*pressure_3.pos, or"
    ):
        robot.send_action(dict.fromkeys([*ACTIONS[:3], "pressure.pos"], 0.0))


def test_a_pose_with_its_pressures_moves_the_robot(robot):
    """As lerobot-rollout sends it between episodes."""
    seen = robot.get_observation()
    pose = {name: seen[name] for name in ("ee_x.pos", "ee_y.pos", "ee_z.pos", *ACTIONS[3:])}
    pose |= {"ee_x.pos": pose["ee_x.pos"] + 0.05, "pressure_2.pos": 15.0}
    for _ in range(30):
        robot.send_action(pose)
    seen = robot.get_observation()
    assert seen["ee_x.pos"] == pytest.approx(pose["ee_x.pos"], abs=1e-3)
    assert seen["pressure_2.pos"] == pytest.approx(15.0)


def test_demonstrations_are_recorded(folder, tmp_path):
    robot = PneutacSim(PneutacSimConfig(id="arm", task="button", twin=folder, fidelity="probe"))
    teleop = PneutacScripted(PneutacScriptedConfig(id="expert"))
    assert teleop.action_features == robot.action_features
    root = record_episodes(robot, teleop, "local/arm", tmp_path / "data", 1, "press", False)
    data = LeRobotDataset("local/arm", root=root)
    assert data.features["action"]["names"] == ACTIONS
    assert data.features["observation.state"]["names"] == list(state_names(7, 3))
    actions = np.stack([data[i]["action"] for i in range(len(data))])
    assert actions[:, 3:].min() >= 0 and actions[:, 3].max() > 20 and actions[:, 5].max() > 5


def test_the_environment_gives_what_its_config_promises(folder):
    config = PneutacEnvConfig(task="button", twin=folder, fidelity="probe", episode_length=2)
    env = make_env(config, n_envs=1)["pneutac"][0]
    observation, _ = env.reset(seed=[1])
    found = {k: tuple(v.shape[1:]) for k, v in preprocess_observation(observation).items()}
    promised = {k: f.shape for k, f in env_to_policy_features(config).items()}
    assert promised.pop("action") == env.single_action_space.shape == (6,)
    assert found == promised and found["observation.state"] == (22,)
    env.close()


def test_what_does_not_work_is_refused_before_any_work(folder):
    for kind, option in ((PneutacSimConfig, "robot"), (PneutacEnvConfig, "env")):
        with pytest.raises(
            DecodingError, match=f"--{option}.twin: Fidelity 'surrogate' .* give fidelity=probe"
        ):
            kind(twin=folder)
    with pytest.raises(
        DecodingError, match="--robot.bend=true commands the bend of one chamber and --robot.twin has"
    ):
        PneutacSimConfig(twin=folder, fidelity="probe", bend=True)
