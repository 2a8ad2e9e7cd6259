"""LeRobot's remote inference: its server drops observations that it takes for similar to the last."""

import json
import pickle
from importlib import import_module

import pytest

from lerobot_pneutac.cli import run_verb
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from pneutac_sim.features import STATE_NAMES


@pytest.fixture(scope="module")
def lerobot(tmp_path_factory):
    """`helpers` of the client, and the module of the server; on import they make a folder of logs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("logs"))
        names = ("helpers", "policy_server", "configs")
        yield [import_module(f"lerobot.async_inference.{name}") for name in names]


def test_the_server_takes_what_a_creeping_finger_shows(lerobot, tmp_path, monkeypatch):
    helpers, policy_server, configs = lerobot
    monkeypatch.setattr(helpers.TimedObservation, "must_go", False)
    robot = PneutacSim(PneutacSimConfig(id="r", standin=True, task="card", calibration_dir=tmp_path))
    server = policy_server.PolicyServer(configs.PolicyServerConfig())
    server.lerobot_features = helpers.map_robot_keys_to_lerobot_features(robot)

    def taken(step: int, observation: dict) -> bool:
        sent = helpers.TimedObservation(timestamp=0.0, observation=observation, timestep=step)
        sent.must_go = False  # as the client sets it while it has actions left
        return server._enqueue_observation(pickle.loads(pickle.dumps(sent)))

    robot.connect()
    hold = dict(zip(robot.action_features, (0.0, 0.0, 0.0, 12.0), strict=True))
    for _ in range(30):  # the air is at its pressure, the finger creeps on
        robot.send_action(hold)
    before, tip = robot.get_observation(), robot.world.gel_m.copy()
    for _ in range(150):
        robot.send_action(hold)
    after, crept = robot.get_observation(), robot.world.gel_m - tip
    assert abs(crept).max() > 5e-4  # m
    assert all(abs(after[n] - before[n]) < 0.5 for n in STATE_NAMES)
    server.last_processed_obs = helpers.TimedObservation(timestamp=0.0, timestep=0, observation=before)
    assert taken(180, after)
    robot.disconnect()
    monkeypatch.setattr(helpers.TimedObservation, "must_go", False)  # without the robot's hook
    assert not taken(180, after)


@pytest.mark.nightly
def test_server_and_client_of_lerobot_drive_the_stand_in(tmp_path):
    """The commands of the page on remote inference; how fast depends on what else the computer does."""
    run_verb("benchmark", ["rates", "--hz=[15]", "--commands=[remote]", "--seconds=4", f"--out={tmp_path}"])
    (row,) = json.loads((tmp_path / "result.json").read_text())["rows"]
    assert row["achieved_hz"] > 5
