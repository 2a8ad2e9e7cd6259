"""Writing LeRobotDatasets offline: no frame is lost, however fast, and the console stays quiet."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import av
from lerobot.datasets import LeRobotDataset

import datasets
from pneutac_sim.errors import InputError


def create_dataset(
    repo_id: str,
    root: str | Path,
    fps: int,
    features: dict,
    robot_type: str,
    use_videos: bool,
    longest_episode: int,
    encoder_threads: int | None = None,
) -> LeRobotDataset:
    """A new LeRobotDataset for unpaced writing.

    The video encoder drops frames that it cannot queue, so its queue holds the longest episode, in frames.

    Raises:
        InputError: `root` exists.
    """
    if Path(root).exists():
        raise InputError(f"'{root}' exists; give a new folder for dataset '{repo_id}'.")
    encoding = {"streaming_encoding": use_videos, "encoder_queue_maxsize": longest_episode + 1}
    encoding["encoder_threads"] = encoder_threads  # as many as it likes where there is no number
    how = {"use_videos": use_videos, "image_writer_threads": 2, "video_backend": "pyav"}
    return LeRobotDataset.create(repo_id, fps, features, root, robot_type, **how, **encoding)


@contextlib.contextmanager
def quiet_encoders() -> Iterator[None]:
    """Silences the video encoder and the progress bars of Hugging Face datasets while it lasts."""
    svt, bars = os.environ.get("SVT_LOG"), datasets.is_progress_bar_enabled()
    os.environ["SVT_LOG"] = "1"  # SVT-AV1 reads it when an encoder opens; 1 is errors only
    av.logging.set_libav_level(av.logging.ERROR)  # LeRobot logs through libav's own callback
    datasets.disable_progress_bars()
    try:
        yield
    finally:
        if svt is None:
            del os.environ["SVT_LOG"]
        else:
            os.environ["SVT_LOG"] = svt
        av.logging.set_libav_level(av.logging.INFO)
        if bars:
            datasets.enable_progress_bars()


@contextlib.contextmanager
def written(dataset: LeRobotDataset) -> Iterator[None]:
    """While episodes are added to a dataset: quiet, and whole at the end, come what may."""
    with quiet_encoders():
        try:
            yield
        finally:
            dataset.finalize()
