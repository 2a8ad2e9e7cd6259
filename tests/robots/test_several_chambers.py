"""A body of three chambers as LeRobot sees it: robot, scripted teleoperator, environment, dataset."""

import time

import numpy as np
import pytest
import torch
from arms import arm_twin
from draccus.utils import DecodingError
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_pneutac.rl.options import PpoConfig
from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef
from lerobot_robot_pneutac.env import PneutacEnvConfig
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PneutacBCConfig
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig, VelocityTeleopConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from lerobot_robot_pneutac.teleoperators.velocity_teleop import VelocityTeleop
from pneutac_datasets.demonstrations.augment.planner import CemPlanner, PlannerConfig
from pneutac_datasets.demonstrations.augment.reference import read_references
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_datasets.demonstrations.record import record_episodes
from pneutac_sim.errors import InputError
from pneutac_sim.features import action_names, state_names
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import Variation
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.world import World

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
    with pytest.raises(InputError, match="one pressure and the finger 3 chambers; by hand give --teleop.ch"):
        robot.send_action(dict.fromkeys([*ACTIONS[:3], "pressure.pos"], 0.0))
    with pytest.raises(InputError, match="the keys dx.vel; the robot takes .*pressure_3.pos, or"):
        robot.send_action({"dx.vel": 0.0})


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


@pytest.fixture(scope="module")
def demonstrations(folder, tmp_path_factory):
    """Two, of the button."""
    robot = PneutacSim(PneutacSimConfig(id="arm", task="button", twin=folder, fidelity="probe"))
    teleop = PneutacScripted(PneutacScriptedConfig(id="expert"))
    assert teleop.action_features == robot.action_features
    root = tmp_path_factory.mktemp("demonstrations") / "data"
    return record_episodes(robot, teleop, "local/arm", root, 2, "press", False)


def test_demonstrations_are_recorded(demonstrations):
    data = LeRobotDataset("local/arm", root=demonstrations)
    assert data.features["action"]["names"] == ACTIONS
    assert data.features["observation.state"]["names"] == list(state_names(7, 3))
    actions = np.stack([data[i]["action"] for i in range(len(data))])
    assert actions[:, 3:].min() >= 0 and actions[:, 3].max() > 20 and actions[:, 5].max() > 5


def test_a_policy_is_sized_by_the_demonstrations(demonstrations, tmp_path):
    meta = LeRobotDatasetMetadata("local/arm", demonstrations)
    features = dataset_to_policy_features(meta.features)
    config = PneutacBCConfig(device="cpu")
    config.output_features = {"action": features.pop("action")}
    config.input_features = features
    policy = PneutacBCPolicy(config, dataset_meta=meta)
    assert (config.joints, config.chambers) == (7, 3)
    assert policy._action_high[3:].tolist() == pytest.approx(meta.stats["action"]["max"][3:], abs=1e-4)
    assert policy._action_low[3:].tolist() == [0.0, 0.0, 0.0]
    data = LeRobotDataset("local/arm", root=demonstrations, delta_timestamps={"action": [-1 / 15, 0.0]})
    batch = torch.utils.data.default_collate([data[i] for i in (0, 40, 80)])
    policy.train()
    loss, terms = policy.forward(batch)
    loss.backward()
    assert loss.isfinite() and policy.mlp[0].weight.grad.abs().sum() > 0
    seen = {k: v[:1] for k, v in batch.items() if k.startswith("observation")}
    action = policy.select_action(seen)
    assert action.shape == (1, 6) and (action <= policy._action_high).all()
    policy.save_pretrained(tmp_path)
    assert "`pressure_3.pos` | kPa" in (tmp_path / "README.md").read_text()


def test_a_plan_follows_the_demonstrated_touch(demonstrations, folder):
    """The planner moves all six numbers, and keeps within their limits."""
    twin = Twin.load(folder)
    _, references = read_references(Recorded(demonstrations), "local/arm", TactileSensor(twin))
    r = references[0]
    world = World("button", twin, "area", "probe")
    world.variation = Variation(tuple(r.flange_m[0]))
    world.reset(5)
    gantry = Gantry(world)
    gantry.mirror(world)
    config = PlannerConfig(samples=4, elites=2, iterations=1, horizon=6)
    planner = CemPlanner(gantry, config, np.random.default_rng(0))
    warm = np.clip(r.action[20:26], *world.action_limits)
    planner.begin(warm, np.zeros(6), r.area[21:27], r.flange_m[21:27])
    plan = planner.solve()
    assert plan.shape == (6, 6) and np.isfinite(planner.cost)
    assert (plan >= world.action_limits[0]).all() and (plan <= world.action_limits[1]).all()
    for action in plan:  # the reduced world goes where the world goes
        world.step(action)
    gantry.rollout(plan)
    np.testing.assert_allclose(gantry.spine_rad, world.spine_rad, atol=2e-3)
    np.testing.assert_allclose(gantry.gel_m, world.gel_m, atol=1e-3)


def test_demonstrations_of_another_body_are_reported(demonstrations, folder):
    faults = Recorded(demonstrations).faults(Twin.builtin())
    sentence = "'action' has 3 pressures and the twin 1 chamber; give the twin of the body that was recorded."
    assert any(f.endswith(sentence) for f in faults)
    assert not Recorded(demonstrations).faults(Twin.load(folder))


def test_a_hand_leads_the_chambers_by_their_shares(folder, robot):
    class Hand(VelocityTeleop):
        name, config_class = "hand", VelocityTeleopConfig

        def _open(self):
            pass

        def _close(self):
            pass

        def _read(self):
            return np.array([1.0, 0.0, 0.0]), self.change

    hand = Hand(VelocityTeleopConfig(id="hand", chamber_shares=[1, 0, 0.5], pressure_rate_kpa_s=100.0))
    hand.change = 0.0
    hand._let_go = True
    hand.connect()
    hand._let_go, hand.change = True, 1.0
    time.sleep(0.05)
    action = hand.get_action()
    assert list(action) == ACTIONS == list(hand.action_features) and action["pressure_1.pos"] > 1.0
    assert action["pressure_2.pos"] == 0 and action["pressure_3.pos"] == 0.5 * action["pressure_1.pos"]
    robot.send_action(action)
    few = "give 3 numbers from 0 to 1"
    for wrong, said in (
        ({"chamber_shares": [1.0]}, few),
        ({"chamber_shares": [0.0, 0.0, 0.0]}, few),
        ({"chamber_shares": [1, 0, 0], "bend_range_rad": (0.1, 1.0)}, "bend_range_rad is for one chamber"),
    ):
        with pytest.raises(DecodingError, match=said):
            VelocityTeleopConfig(**wrong)


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
    with pytest.raises(InputError, match="ppo trains fingers of one chamber and .* has several; record"):
        PpoConfig(out=folder / "ppo", twin=folder)
    given = {"dataset": DatasetRef("local/arm", folder), "output": DatasetRef("local/new", folder / "new")}
    with pytest.raises(
        InputError, match="Fidelity 'mpm' is for fingers of one chamber; this twin's arm has 3"
    ):
        AugmentConfig(**given, twin=folder, fidelity="probe", check_mpm=1)
