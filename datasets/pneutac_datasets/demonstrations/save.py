"""Writing LeRobotDatasets offline: no frame is lost, however fast, and the console stays quiet."""

import contextlib
import io
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from datasets.table import embed_table_storage
from lerobot.datasets import LeRobotDataset

import datasets
from lerobot_robot_pneutac.lerobot_inside import RunningQuantileStats, StreamingVideoEncoder, replaced
from pneutac_sim.errors import InputError


def create_dataset(
    repo_id: str,
    root: str | Path,
    fps: int,
    features: dict,
    robot_type: str,
    use_videos: bool,
    longest_episode: int,
    videos_mb: int | None = None,
) -> LeRobotDataset:
    """A new LeRobotDataset for unpaced writing.

    The video encoder drops frames that it cannot queue, so its queue holds the longest episode, in frames. A
    video file grows to `videos_mb`, LeRobot's default where None. Raises InputError: `root` exists.
    """
    if Path(root).exists():
        raise InputError(f"'{root}' exists; give a new folder for dataset '{repo_id}'.")
    encoding = {"streaming_encoding": use_videos, "encoder_queue_maxsize": longest_episode + 1}
    encoding["video_files_size_in_mb"] = videos_mb
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


LEVELS = np.arange(256)


class PixelStatistics(RunningQuantileStats):
    """Statistics of uint8 pixels from how often each level came; of other numbers as LeRobot's.

    LeRobot sorts the pixels of every frame into 5,000 bins, which takes as long as to encode the frame.
    """

    def __init__(self, *options):
        super().__init__(*options)
        self._counts = None

    def update(self, batch: np.ndarray) -> None:
        if batch.dtype != np.uint8:
            return super().update(batch)
        columns = batch.reshape(-1, batch.shape[-1]).T
        counts = np.stack([np.bincount(c, minlength=len(LEVELS)) for c in columns])
        self._counts = counts if self._counts is None else self._counts + counts

    def get_statistics(self) -> dict[str, np.ndarray]:
        if self._counts is None:
            return super().get_statistics()
        counts, so_far = self._counts, np.cumsum(self._counts, 1)
        n = so_far[0, -1]
        mean = counts @ LEVELS / n
        out = {"min": (so_far > 0).argmax(1), "max": (so_far == n).argmax(1), "mean": mean}
        out["std"] = np.sqrt(np.maximum(counts @ LEVELS**2 / n - mean**2, 0))
        quantiles = zip(self._quantile_keys, self._quantile_list, strict=True)
        out |= {key: (so_far >= q * n).argmax(1) for key, q in quantiles}
        return {key: value.astype(float) for key, value in out.items()} | {"count": np.array([n])}


@contextlib.contextmanager
def _quick() -> Iterator[None]:
    """While it lasts, LeRobot's encoders are quiet and its statistics those of above."""
    statistics = replaced("lerobot.datasets.compute_stats", "RunningQuantileStats", PixelStatistics)
    with quiet_encoders(), statistics:
        yield


def _embedded(rows: datasets.Dataset) -> datasets.Dataset:
    """Rows with their images' files inside, which LeRobot reads row by row."""
    found = rows.with_format("arrow").map(embed_table_storage, batched=True, new_fingerprint="embedded")
    return found.with_format(**rows.format)


@contextlib.contextmanager
def written(dataset: LeRobotDataset) -> Iterator[None]:
    """While episodes are added to a dataset: quiet, and whole at the end, come what may."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(_quick())
        # What follows takes longer than all else of a row.
        embed = _embedded if dataset.meta.image_keys else lambda rows: rows
        stack.enter_context(replaced("lerobot.datasets.dataset_writer", "embed_images", embed))
        # Pickles all rows, to find what was computed of them before; nothing is.
        name = replaced("datasets.arrow_dataset", "generate_fingerprint", lambda rows: "episode")
        stack.enter_context(name)
        stack.callback(dataset.finalize)
        yield


class Film(NamedTuple):
    """An episode's video, encoded."""

    data: bytes  # of an MP4 file
    statistics: dict[str, np.ndarray]  # of its pixels, name to (3,) in levels, or (1,) `count`


def encode(images: Mapping[str, np.ndarray], fps: int) -> dict[str, Film]:
    """Encodes videos uint8 (T, H, W, 3) by name, as LeRobot does while it records, on one thread each."""
    if not images:
        return {}
    longest = max(map(len, images.values()))
    encoder = StreamingVideoEncoder(fps, queue_maxsize=longest + 1, encoder_threads=1)
    with tempfile.TemporaryDirectory() as folder, _quick():
        encoder.start_episode(list(images), Path(folder))
        for key, frames in images.items():
            for frame in frames:
                encoder.feed_frame(key, frame)
        return {key: Film(file.read_bytes(), s) for key, (file, s) in encoder.finish_episode().items()}


def decode(film: Film) -> np.ndarray:
    """The frames of a video, uint8 (T, H, W, 3)."""
    with av.open(io.BytesIO(film.data)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


class EncodedVideos:
    """Stands in a dataset's writer for LeRobot's encoder: `films` are the next episode's videos."""

    def __init__(self, dataset: LeRobotDataset):
        self.films: Mapping[str, Film] = {}
        self._root, dataset.writer._streaming_encoder = dataset.root, self

    def start_episode(self, **_) -> None: ...

    def feed_frame(self, *_) -> None: ...

    def finish_episode(self) -> dict[str, tuple[Path, dict]]:
        out = {}
        for key, film in self.films.items():
            file = Path(tempfile.mkdtemp(dir=self._root)) / "film.mp4"  # LeRobot removes the folder
            file.write_bytes(film.data)
            out[key] = file, film.statistics
        return out

    def close(self) -> None: ...
