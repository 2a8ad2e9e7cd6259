"""Demonstrations in memory: a LeRobotDataset's episodes as arrays, and back."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from types import MappingProxyType

import numpy as np
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION, DEFAULT_FEATURES, OBS_STATE, OBS_STR
from torch import Tensor

from lerobot_robot_pneutac.lerobot_inside import decode_video_frames
from pneutac_datasets.demonstrations.faults import FURTHER, TACTILE, feature_faults
from pneutac_sim.errors import InputError
from pneutac_sim.features import (
    POINTS_KEY,
    POINTS_SIZE,
    VELOCITY_NAMES,
    Places,
    joint_count,
)
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.world.task_env import points_info

POINTS = f"{OBS_STR}.{POINTS_KEY}"  # touch as data
DECODED_AT_ONCE = 200  # images of a video, which take 50 MB


@dataclass
class Episode:
    """One demonstration."""

    state: np.ndarray  # (T, 2 N + 5 + C) as `features.state_names` of an arm of N joints and C chambers
    action: np.ndarray  # (T, 3 + C) as `features.action_names`
    images: np.ndarray  # uint8 (T, H, W, 3) of the sensor's size
    task: str  # the instruction
    fps: int  # frames per second

    def __len__(self) -> int:
        return len(self.state)

    @property
    def angles(self) -> slice:
        """Where the joints' angles are in the state."""
        return slice(0, joint_count(self.state.shape[1], self.chambers))

    @property
    def chambers(self) -> int:
        """Number of chambers C of the finger."""
        return self.action.shape[1] - len(VELOCITY_NAMES)

    @property
    def places(self) -> Places:
        """Indices of the state after the joints."""
        return Places.of(self.chambers)

    @property
    def rates(self) -> slice:
        """Where the joints' rates are in the state."""
        return slice(self.angles.stop, 2 * self.angles.stop)

    def at(self, times: np.ndarray) -> "Episode":
        """The episode played at fractional frame numbers `times` (T',), T' > 1.

        Images and contact are those of the nearest frame, so that they belong together.
        """
        state, action = self._seen(times), _between(self.action, times)
        pace = np.gradient(times)[:, None]  # the velocities follow the pace
        state[:, self.rates] *= pace
        action[:, :3] *= pace
        return replace(self, state=state, action=action, images=self.images[_nearest(times)])

    def resampled(self, fps: int) -> "Episode":
        """The same at another rate: what was seen then, and commands that add up to the same.

        A command holds for its frame, so that one of longer frames is the mean of those that it spans.
        """
        if fps == self.fps:
            return self
        times = np.arange(0, len(self) - 1 + 1e-9, self.fps / fps)
        held = np.cumsum(np.vstack([np.zeros(self.action.shape[1]), self.action]), 0)
        ends = np.append(times, min(times[-1] + self.fps / fps, len(self)))
        action = np.diff(_between(held, ends), axis=0) / np.diff(ends)[:, None]
        return Episode(self._seen(times), action, self.images[_nearest(times)], self.task, fps)

    def _seen(self, times: np.ndarray) -> np.ndarray:
        """State at fractional frame numbers; contact is that of the nearest frame's image."""
        state, contact = _between(self.state, times), [self.places.area, self.places.pixels]
        state[:, contact] = self.state[_nearest(times)][:, contact]
        return state

    @property
    def pixels(self) -> int:
        """Number of pixels of a tactile image."""
        return self.images.shape[1] * self.images.shape[2]

    def contact(self) -> tuple[int, int] | None:
        """First and last frame in contact, without isolated noise pixels, or None."""
        frames = np.flatnonzero(without_specks(self.state[:, self.places.area]))
        return (int(frames[0]), int(frames[-1])) if len(frames) else None


def _between(rows: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Rows (T, k) at fractional row numbers (T',): (T', k)."""
    return np.stack([np.interp(times, np.arange(len(rows)), column) for column in rows.T], 1)


def _nearest(times: np.ndarray) -> np.ndarray:
    return np.round(times).astype(int)


def demonstration_features(meta: LeRobotDatasetMetadata) -> dict:
    """The dataset's own features but `FURTHER`; raises InputError where they are no pneutac robot's."""
    if faults := feature_faults(meta.features, Path(meta.root) / "meta" / "info.json"):
        raise InputError(faults[0])
    features = {k: dict(f) for k, f in meta.features.items() if k not in (*DEFAULT_FEATURES, *FURTHER)}
    features[TACTILE] = _before_encoding(features[TACTILE])
    return features


def further_features(meta: LeRobotDatasetMetadata) -> dict:
    """The features of `FURTHER` that a dataset has."""
    return {k: _before_encoding(meta.features[k]) for k in FURTHER if k in meta.features}


def _before_encoding(feature: dict) -> dict:
    """A feature without the encoder's own entries, which are rewritten with the first video."""
    info = feature.get("info") or {}
    return {**feature, "info": {k: v for k, v in info.items() if not k.startswith("video.")}}


def points_feature(window_mm: tuple[float, float]) -> dict:
    """LeRobot's description of `POINTS`, of a gel whose window has that width and height."""
    return {"dtype": "float32", "shape": (POINTS_SIZE,), "names": None, "info": points_info(window_mm)}


@contextmanager
def readable(folder: str | Path) -> Iterator[None]:
    """While LeRobot reads a dataset: what it raises, of Arrow, FFmpeg or the Hub, becomes one sentence.

    Raises InputError: it could not be read.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as e:
        reason = " ".join(str(e).split())[:200]
        raise InputError(
            f"{folder} cannot be read by LeRobot ({type(e).__name__}: {reason}); restore it, or see what"
            f" `pneutac check {quote(str(folder))}` and `pneutac repair --dataset={quote(str(folder))}` say."
        ) from e


def load_episode(dataset: LeRobotDataset, index: int) -> Episode:
    """Reads an episode whole; raises InputError where it has one frame only, NaN or infinity."""
    row = dataset.meta.episodes[index]
    begin, end = row["dataset_from_index"], row["dataset_to_index"]
    if end - begin < 2:
        raise InputError(f"Dataset '{dataset.repo_id}': episode {index} has one frame only; delete it.")
    frames = dataset.hf_dataset[begin:end]
    state, action = (np.stack(frames[k]).astype(float) for k in (OBS_STATE, ACTION))
    if not (np.isfinite(state).all() and np.isfinite(action).all()):
        raise InputError(f"Dataset '{dataset.repo_id}': episode {index} holds NaN or infinity; delete it.")
    images = frames[TACTILE] if TACTILE in frames else _decoded(dataset, index, frames["timestamp"])
    images = np.stack([_as_uint8(image) for image in images])
    task = dataset.meta.tasks.iloc[int(frames["task_index"][0])].name
    return Episode(state, action, images, task, dataset.meta.fps)


def _decoded(dataset: LeRobotDataset, index: int, times_s: Sequence) -> Iterator[Tensor]:
    """The images (3, H, W) of an episode's video; one by one each would be decoded from a key frame on."""
    row, path = dataset.meta.episodes[index], dataset.root / dataset.meta.get_video_file_path(index, TACTILE)
    times_s = [row[f"videos/{TACTILE}/from_timestamp"] + float(t) for t in times_s]
    for first in range(0, len(times_s), DECODED_AT_ONCE):
        part = times_s[first : first + DECODED_AT_ONCE]
        yield from decode_video_frames(path, part, dataset.tolerance_s, "pyav", return_uint8=True)


def _as_uint8(image) -> np.ndarray:
    """(3, H, W) uint8 or float in [0, 1] to uint8 (H, W, 3); videos come as the first, PNGs as the second."""
    array = image.permute(1, 2, 0).numpy()
    return array if array.dtype == np.uint8 else (array * 255).round().astype(np.uint8)


def save_episode(
    dataset: LeRobotDataset, episode: Episode, more: Mapping[str, np.ndarray] = MappingProxyType({})
) -> None:
    """Appends an episode to a dataset that is being written; `more` holds (T, ...) of further features."""
    columns = {OBS_STATE: episode.state, ACTION: episode.action, TACTILE: episode.images} | dict(more)
    for row in zip(*columns.values(), strict=True):
        dataset.add_frame(dict(zip(columns, row, strict=True)) | {"task": episode.task})
    dataset.save_episode()
