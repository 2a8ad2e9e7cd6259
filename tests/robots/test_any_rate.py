"""A station of 30 Hz: recorded, checked, augmented and learnt; demonstrations of another rate are refused."""

import json
import logging
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata, io_utils
from lerobot.policies import make_policy
from lerobot.utils.constants import OBS_STATE
from played import succeeds

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef, augment
from lerobot_pneutac.verbs.check import check_path
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PneutacBCConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.standin.world import StandinWorld
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.augment.planner import PlannerConfig
from pneutac_datasets.demonstrations.record import record_episodes
from pneutac_sim.errors import InputError
from pneutac_sim.features import EE
from pneutac_sim.world.station import Station

GOLDEN = Path(__file__).parents[1] / "golden" / "recordings" / "demos"


@pytest.fixture(scope="module")
def station(tmp_path_factory):
    file = tmp_path_factory.mktemp("lab") / "station.yaml"
    file.write_text("format: pneutac-station/1\ncontrol_hz: 30\n")
    return file


@pytest.fixture(scope="module")
def recorded(station, tmp_path_factory):
    """Two demonstrations."""
    own = {"calibration_dir": tmp_path_factory.mktemp("calibration")}
    robot = PneutacSim(
        PneutacSimConfig(id="fast", seed=1, task="card", fidelity="probe", station=station, **own)
    )
    teleop = PneutacScripted(PneutacScriptedConfig(id="script", seed=1, **own))
    root = tmp_path_factory.mktemp("data") / "demos"
    return record_episodes(robot, teleop, "local/fast", root, 2, "card", False)


@pytest.mark.nightly
def test_30_hz_are_recorded_checked_augmented_and_learnt(station, recorded, tmp_path, capsys):
    demos = LeRobotDataset("local/fast", recorded)
    assert demos.fps == 30
    first = demos.hf_dataset.with_format("numpy")[: demos.meta.episodes[0]["length"]]
    state = np.stack(first[OBS_STATE])
    speed = np.linalg.norm(np.diff(state[:, EE], axis=0), axis=1) * 30
    assert 0.06 < np.quantile(speed, 0.95) < 0.11  # m/s, as at any rate
    run_verb("check", [str(recorded), f"--station={station}"])
    assert "good" in capsys.readouterr().out

    options = {
        "dataset": DatasetRef("local/fast", recorded),
        "output": DatasetRef("local/more", tmp_path / "more"),
        "task": "card",
        "method": "planner",
        "fidelity": "probe",
        "planner": PlannerConfig(samples=4, elites=2, iterations=1),
        "episodes": 1,
        "workers": 1,
    }
    augment(AugmentConfig(**options, station=station))
    assert Station.load(tmp_path / "more" / "meta" / "station.yaml") == Station.load(station)
    (recorded / "meta" / "station.yaml").unlink()
    more = LeRobotDatasetMetadata("local/more", tmp_path / "more")
    assert (more.fps, more.total_episodes) == (30, 1)
    with pytest.raises(InputError, match="30 fps, but the station's control rate is 15 Hz; give the station"):
        augment(AugmentConfig(**options))

    policy = make_policy(PneutacBCConfig(device="cpu"), ds_meta=demos.meta)
    assert policy.config.control_hz == 30
    with pytest.raises(InputError, match="30 frames per second and the policy's control_hz is 15"):
        make_policy(PneutacBCConfig(device="cpu", control_hz=15), ds_meta=demos.meta)


def test_demonstrations_of_15_hz_are_refused_in_a_station_of_30(station):
    (said,) = check_path(GOLDEN, station=Station.load(station)).faults
    assert "15 fps, but the station's control rate is 30 Hz" in said and "\n" not in said
    assert check_path(GOLDEN).faults == []


def test_a_dataset_of_another_rate_than_the_robots_is_refused_before_it_is_begun(tmp_path, monkeypatch):
    monkeypatch.setattr(io_utils, "write_json", io_utils.write_json)
    robot = PneutacSim(PneutacSimConfig(id="t", fidelity="probe"))
    begin = partial(LeRobotDataset.create, "local/a", features={}, root=tmp_path / "a", use_videos=False)
    with pytest.raises(InputError, match="has 30 frames per second .* record at --dataset.fps=15, or"):
        begin(fps=30, robot_type=robot.name)
    begin(fps=30, robot_type="another")  # nothing was left in its way
    LeRobotDataset.create("local/b", 15, {}, tmp_path / "b", robot.name, use_videos=False)


def test_a_dataset_of_another_rate_that_is_gone_on_with_is_reported(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(io_utils, "write_json", io_utils.write_json)
    robot = PneutacSim(PneutacSimConfig(id="t", fidelity="probe"))
    info = {"total_frames": 20, "total_episodes": 1, "fps": 30, "robot_type": robot.name}
    (tmp_path / "info.json").write_text("{}")
    with caplog.at_level(logging.WARNING):
        io_utils.write_json(info, tmp_path / "info.json")
    assert "record at --dataset.fps=15" in caplog.text
    assert json.loads((tmp_path / "info.json").read_text()) == info


@pytest.mark.parametrize("control_hz", [10, pytest.param(30, marks=pytest.mark.nightly)])
def test_the_stand_in_does_its_task_at_another_rate(control_hz):
    world = StandinWorld("card", touch="area", station=Station(control_hz=control_hz))
    assert succeeds(world, 1, steps=12 * control_hz)
    assert world.time_s > 2
