import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.record import record_episodes
from pneutac_sim.features import STATE_NAMES


@pytest.mark.slow
def test_records_successful_demonstrations_frame_by_frame(tmp_path):
    common = {"seed": 1, "calibration_dir": tmp_path / "calibration"}
    robot = PneutacSim(PneutacSimConfig(id="sim", **common))
    teleop = PneutacScripted(PneutacScriptedConfig(id="script", episode_steps=90, **common))
    root = record_episodes(robot, teleop, "local/x", tmp_path / "x", 2, "flip the switch", True)
    dataset = LeRobotDataset("local/x", root, video_backend="pyav")
    assert (dataset.num_episodes, dataset.fps) == (2, 15)
    starts = [e["dataset_from_index"] for e in dataset.meta.episodes]
    ends = [e["dataset_to_index"] for e in dataset.meta.episodes]
    assert max(np.subtract(ends, starts)) < 90  # an episode ends when the task is done
    assert dataset.meta.robot_type == "pneutac"
    assert sum(robot.successes) == 2
    rows = dataset.hf_dataset.with_format("numpy")
    state, action = (np.array(rows[key]) for key in (OBS_STATE, ACTION))
    # The action of a frame shows its effect in the next: the pressure is the one commanded.
    p = STATE_NAMES.index("pressure.pos")
    for start, end in zip(starts, ends, strict=True):
        assert state[start, p] == 0
        np.testing.assert_allclose(state[start + 1 : end, p], action[start : end - 1, 3], atol=1e-5)
    # Image and contact area belong together: the video shows a change where the area says contact.
    area = state[:, STATE_NAMES.index("contact_area.pos")]
    first, most = (dataset[i][f"{OBS_IMAGES}.tactile"] * 255 for i in (0, int(area.argmax())))
    assert (first - most).abs().max() > 20
    rest = [i for i in range(len(area)) if area[i] == 0][-1]
    assert (first - dataset[rest][f"{OBS_IMAGES}.tactile"] * 255).abs().mean() < 3
