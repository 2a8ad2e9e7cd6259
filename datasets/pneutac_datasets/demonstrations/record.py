"""Records demonstrations faster than wall time: lerobot-record's loop without its sleeps.

The same Robot and Teleoperator objects, the same order of calls, features and dataset code as lerobot-record,
so that what comes out merges with its recordings.
"""

from pathlib import Path

from lerobot.datasets import LeRobotDataset
from lerobot.utils.constants import ACTION, OBS_STR
from lerobot.utils.feature_utils import build_dataset_frame, combine_feature_dicts, hw_to_dataset_features

from lerobot_robot_pneutac.options import gel_of
from lerobot_robot_pneutac.robots.episode_hooks import store_station
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.card import write_card
from pneutac_datasets.demonstrations.episodes import POINTS, points_feature
from pneutac_datasets.demonstrations.save import create_dataset, written
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import POINTS_KEY
from pneutac_sim.gel.contact import SPECKS

SIMULATED = "Recorded in simulation; a script played the operator."


def record_episodes(
    robot: PneutacSim,
    teleop: PneutacScripted,
    repo_id: str,
    root: str | Path,
    episodes: int,
    task_text: str,
    use_videos: bool,
    progress: Progress = no_progress,
) -> Path:
    """Records demonstrations of a scripted teleoperator into a new folder `root`, which is returned.

    An episode ends when the task is done, as if the person pressed the key for the next one, or after the
    teleoperator's `steps`; a failed one is recorded again. A robot that is not connected is connected for the
    recording only. `task_text` is stored with every frame; without `use_videos` images are PNG. Raises
    InputError where `root` exists, or three of four demonstrations fail.
    """
    features = combine_feature_dicts(
        hw_to_dataset_features(robot.action_features, ACTION, use_videos),
        hw_to_dataset_features(robot.observation_features, OBS_STR, use_videos),
    )
    if robot.config.tactile_points:
        features[POINTS] = points_feature(gel_of(robot.config.twin).window_mm)
    length = teleop.steps(robot)
    dataset = create_dataset(repo_id, root, robot.config.control_hz, features, robot.name, use_videos, length)
    store_station(robot, Path(root) / "meta")
    ours = [device for device in (teleop, robot) if not device.is_connected]
    for device in ours:
        device.connect()
    failed = 0
    with written(dataset):
        try:
            for done in range(episodes):
                progress("recording demonstrations", done, episodes)
                while not _record_episode(robot, teleop, dataset, task_text):
                    dataset.clear_episode_buffer()
                    failed += 1
                    if failed > 4 + 3 * done:
                        raise InputError(
                            f"{failed} scripted demonstrations failed and {done} succeeded; can the twin's"
                            f" finger do the task '{robot.config.task}' in {length} steps?"
                        )
                dataset.save_episode()
        finally:
            for device in ours:
                device.disconnect()
    write_card(root, source=SIMULATED)
    return Path(root)


def _record_episode(robot: PneutacSim, teleop: PneutacScripted, dataset: LeRobotDataset, task: str) -> bool:
    """One demonstration into the episode buffer; returns whether the task was done, by touch."""
    scalars_and_images = {key: feature for key, feature in dataset.features.items() if key != POINTS}
    felt = False
    for _ in range(teleop.steps(robot)):
        observation = robot.get_observation()
        felt = felt or observation["contact_area.pos"] >= SPECKS
        action = teleop.get_action()
        points = {POINTS: observation[POINTS_KEY]} if POINTS_KEY in observation else {}
        dataset.add_frame(
            {
                **points,
                **build_dataset_frame(scalars_and_images, observation, OBS_STR),
                **build_dataset_frame(dataset.features, action, ACTION),
                "task": task,
            }
        )
        robot.send_action(action)
        if robot.world.success or robot.world.failure:
            break
    done = robot.world.success and not robot.world.failure and felt
    robot.reset()
    return done
