"""lerobot-record tells a robot neither that an episode begins nor that it has ended."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from lerobot.configs.dataset import DatasetRecordConfig
from lerobot.datasets import LeRobotDataset
from lerobot.robots import Robot, RobotConfig
from lerobot.scripts.lerobot_record import RecordConfig, record
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

CALLS: list[str] = []


@RobotConfig.register_subclass("counted")
@dataclass(kw_only=True)
class CountedConfig(RobotConfig):
    """No options."""


class Counted(Robot):
    """One joint, which writes down what it is asked."""

    config_class, name = CountedConfig, "counted"
    observation_features = action_features = {"joint.pos": float}
    is_connected, is_calibrated, cameras = True, True, {}

    def connect(self, calibrate=True):
        CALLS.append("connect")

    def calibrate(self):
        pass

    configure = calibrate

    def get_observation(self):
        CALLS.append("observe")
        return {"joint.pos": 0.0}

    def send_action(self, action):
        return action

    def disconnect(self):
        CALLS.append("disconnect")


@TeleoperatorConfig.register_subclass("still")
@dataclass(kw_only=True)
class StillConfig(TeleoperatorConfig):
    """No options."""


class Still(Teleoperator):
    """Asks the joint to stay."""

    config_class, name = StillConfig, "still"
    action_features, feedback_features = {"joint.pos": float}, {}
    is_connected = is_calibrated = True

    def connect(self, calibrate=True):
        pass

    def calibrate(self):
        pass

    configure = disconnect = calibrate

    def get_action(self):
        return {"joint.pos": 0.0}

    def send_feedback(self, feedback):
        pass


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "data"
        options = DatasetRecordConfig(
            repo_id="local/data", single_task="stay", root=root, fps=30, episode_time_s=0.5, reset_time_s=0.5,
            num_episodes=2, push_to_hub=False, no_stamp=True,
        )  # fmt: skip
        record(RecordConfig(robot=CountedConfig(), teleop=StillConfig(), dataset=options, play_sounds=False))
        frames = LeRobotDataset("local/data", root=root).num_frames
    print(f"The robot was asked for {CALLS.count('observe')} observations; {frames} are in the dataset.")
    print(f"Other calls of it: {', '.join(c for c in CALLS if c != 'observe')}.")
