"""A robot whose arm has six joints, from a user's own URDF: recorded, learnt, rolled out."""

import shutil

import numpy as np
import pytest
import torch
from augmenting import config_of
from draccus.utils import DecodingError
from lerobot.datasets import LeRobotDataset
from lerobot.envs import make_env, preprocess_observation
from lerobot.policies import make_policy
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef, augment
from lerobot_robot_pneutac.env import PneutacEnvConfig
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_datasets.demonstrations.naive import augment_naive
from pneutac_datasets.demonstrations.record import record_episodes
from pneutac_sim.errors import InputError
from pneutac_sim.features import state_names
from pneutac_sim.world.arms import ARMS

SIX = len(state_names(6))


@pytest.fixture(scope="module")
def station(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    shutil.copy(ARMS["ur5"][0].urdf, folder / "mine.urdf")
    home = list(ARMS["ur5"][0].home_rad)
    (folder / "station.yaml").write_text(
        f"format: pneutac-station/1\narm: {{urdf: mine.urdf, flange: tool0, home_rad: {home}}}\n"
        "base_m: [0.0, 0.0, 0.05]\n"
    )
    return folder / "station.yaml"


@pytest.fixture(scope="module")
def demos(station, tmp_path_factory):
    own = {"calibration_dir": tmp_path_factory.mktemp("calibration")}
    robot = PneutacSim(
        PneutacSimConfig(id="six", seed=1, task="card", fidelity="probe", station=station, **own)
    )
    teleop = PneutacScripted(PneutacScriptedConfig(id="script", seed=1, episode_steps=120, **own))
    root = tmp_path_factory.mktemp("data") / "demos"
    record_episodes(robot, teleop, "local/six", root, 2, "card", False)
    return LeRobotDataset("local/six", root)


@pytest.mark.slow
def test_six_joints_are_recorded_learnt_and_rolled_out(station, demos, tmp_path):
    assert demos.meta.features[OBS_STATE]["names"] == list(state_names(6))
    torch.manual_seed(0)
    policy = make_policy(PneutacBCConfig(device="cpu"), ds_meta=demos.meta)
    optimizer = torch.optim.Adam(policy.parameters(), lr=1e-3)
    frames = torch.utils.data.default_collate([demos[i] for i in range(0, len(demos), 8)])
    actions = frames[ACTION]
    batch = frames | {
        ACTION: torch.stack([actions, actions], 1),
        "action_is_pad": torch.zeros(len(actions), 2).bool(),
    }
    losses = []
    for _ in range(6):
        loss, _ = policy.forward(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    policy.save_pretrained(tmp_path / "policy")
    policy = PneutacBCPolicy.from_pretrained(tmp_path / "policy")

    config = PneutacEnvConfig(task="card", fidelity="probe", station=station)
    assert config.features["agent_pos"].shape == (SIX,)
    env = make_env(config, n_envs=1)["pneutac"][0]
    observation, _ = env.reset(seed=3)
    for _ in range(5):
        seen = preprocess_observation(observation)
        assert seen[OBS_STATE].shape == (1, SIX)
        action = policy.select_action({OBS_STATE: seen[OBS_STATE].float(), TACTILE: seen[TACTILE]})
        observation, *_ = env.step(action.numpy())
    env.close()


@pytest.mark.slow
def test_its_demonstrations_are_augmented(station, demos, tmp_path):
    augment_naive(Recorded(demos.root), config_of(demos.root, tmp_path / "naive", method="naive", episodes=1))
    varied = LeRobotDataset("local/naive", tmp_path / "naive")
    assert varied.meta.features[OBS_STATE]["names"] == list(state_names(6))
    source = DatasetRef(repo_id="local/six", root=demos.root)
    new = DatasetRef(repo_id="local/planned", root=tmp_path / "planned")
    options = {"dataset": source, "output": new, "task": "card", "fidelity": "probe", "workers": 1}
    paper = tmp_path / "station.yaml"
    paper.write_text("format: pneutac-station/1\n")
    with pytest.raises(InputError, match="has 6 joints, and that of the station 7; give the station.yaml"):
        augment(AugmentConfig(**options, station=paper))


def test_a_bad_station_is_refused_before_any_work(tmp_path):
    (tmp_path / "station.yaml").write_text("format: pneutac-station/1\narm: ur6\n")
    for make in (PneutacEnvConfig, PneutacSimConfig):
        with pytest.raises(DecodingError, match="station: .*arm is 'ur6'"):
            make(station=tmp_path / "station.yaml", fidelity="probe")


def test_a_pose_at_the_start_brings_a_raised_arm_home(station, tmp_path):
    config = PneutacSimConfig(
        id="six", task="card", fidelity="probe", station=station, calibration_dir=tmp_path
    )
    robot = PneutacSim(config)
    robot.connect()
    start = robot.get_observation()
    assert start["ee_z.pos"] == pytest.approx(robot.world.flange_m[2] - 0.05, abs=1e-6)
    for _ in range(3):
        robot.send_action({"dx.vel": 0.1, "dy.vel": 0.0, "dz.vel": 0.0, "pressure.pos": 0.0})
    moved = robot.get_observation()["ee_x.pos"]
    robot.send_action(start)  # as lerobot-rollout does between episodes: the scene starts afresh
    assert len(robot.successes) == 1
    assert np.abs(robot.get_observation()["ee_x.pos"] - start["ee_x.pos"]) < 0.01 < moved - start["ee_x.pos"]
    robot.disconnect()
