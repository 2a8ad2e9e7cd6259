"""All frames of one or several datasets as arrays, each video decoded once from its beginning."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import av
import numpy as np
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.model_card import Demonstrations
from lerobot_robot_pneutac.policy.rest_image import rest_image_of
from lerobot_robot_pneutac.policy.tactile_encoder import TactileEncoder
from pneutac_sim.errors import InputError
from pneutac_sim.files import whole

DECODED = 64  # images pooled together


@dataclass
class Frames:
    """What `pneutac_bc` sees of N frames.

    Attributes:
        state: float32 (N, 20).
        action: float32 (N, 4).
        previous: float32 (N, 4), the action of the frame before; at an episode's start its own.
        first: bool (N,), whether an episode starts there.
        episode: (N,) number of the episode, counted over all datasets.
        difference: float16 (N, 3, 80, 60), see `TactileEncoder.difference`; None without touch.
        rest: float32 (3, 320, 240), the rest image of the data; None without touch.
        demonstrations: what a model card says of them.
    """

    state: np.ndarray
    action: np.ndarray
    previous: np.ndarray
    first: np.ndarray
    episode: np.ndarray
    difference: np.ndarray | None
    rest: torch.Tensor | None
    demonstrations: Demonstrations

    def save(self, path: str | Path) -> None:
        """Writes an .npz file, which appears whole or not at all."""
        arrays = {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        if self.rest is not None:
            arrays["rest"] = self.rest.numpy()
        with whole(Path(path)) as part, part.open("wb") as file:
            np.savez(file, card=np.array(json.dumps(asdict(self.demonstrations))), **arrays)

    @classmethod
    def load(cls, path: str | Path, touch: bool = True) -> "Frames":
        """Reads what `save` wrote, without the images where `touch` is false."""
        with np.load(path, allow_pickle=False) as file:
            card = json.loads(str(file["card"]))
            found = {k: file[k] for k in ("state", "action", "previous", "first", "episode")}
            touch = touch and "rest" in file.files
            found["difference"] = file["difference"] if touch else None
            found["rest"] = torch.from_numpy(file["rest"]) if touch else None
        lists = {k: tuple(card[k]) for k in ("repo_ids", "tasks")}
        return cls(**found, demonstrations=Demonstrations(**card | lists))


def read_frames(*datasets: tuple[str | Path, str]) -> Frames:
    """Reads datasets whose tactile images are videos, several as if they had been merged.

    Args:
        *datasets: folder and repo_id of each.

    Raises:
        InputError: there is no dataset, it has no videos, or it cannot train the policy.
    """
    metas = [_meta(Path(root), repo_id) for root, repo_id in datasets]
    parts = [_numbers(meta) for meta in metas]
    before = 0
    for part, meta in zip(parts, metas, strict=True):
        part["episode"] = part["episode"] + before
        before += meta.total_episodes
    encoder = TactileEncoder()
    rest = rest_image_of(*metas)
    encoder.rest_image.copy_(rest)
    cards = [Demonstrations.of(meta) for meta in metas]
    card = Demonstrations(
        tuple(name for c in cards for name in c.repo_ids),
        sum(c.episodes for c in cards),
        sum(c.frames for c in cards),
        tuple(dict.fromkeys(t for c in cards for t in c.tasks)),
    )
    joined = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    difference = np.concatenate([_differences(meta, encoder) for meta in metas])
    return Frames(**joined, difference=difference, rest=rest, demonstrations=card)


def _meta(root: Path, repo_id: str) -> LeRobotDatasetMetadata:
    if not (root / "meta" / "info.json").is_file():
        raise InputError(f"'{root}' holds no LeRobotDataset (no meta/info.json).")
    meta = LeRobotDatasetMetadata(repo_id, root)
    PneutacBCConfig(device="cpu").check_dataset(meta)
    if TACTILE not in meta.video_keys:
        raise InputError(
            f"Dataset '{repo_id}' has '{TACTILE}' as single pictures; convert it with lerobot-edit-dataset"
            " --operation.type=convert_image_to_video."
        )
    return meta


def _numbers(meta: LeRobotDatasetMetadata) -> dict[str, np.ndarray]:
    dataset = LeRobotDataset(meta.repo_id, meta.root, video_backend="pyav", revision=meta.revision)
    table = dataset.hf_dataset.with_format("numpy")
    state, action = (np.stack(table[k][:]).astype(np.float32) for k in (OBS_STATE, ACTION))
    episode, first = table["episode_index"][:], table["frame_index"][:] == 0
    previous = np.where(first[:, None], action, np.roll(action, 1, axis=0))
    return {"state": state, "action": action, "previous": previous, "first": first, "episode": episode}


def _differences(meta: LeRobotDatasetMetadata, encoder: TactileEncoder) -> np.ndarray:
    """float16 (N, 3, 80, 60) of all frames of a dataset."""
    out, waiting = [], []

    def pool() -> None:
        images = torch.from_numpy(np.stack(waiting)).permute(0, 3, 1, 2).float() / 255
        out.append(encoder.difference(images).half().numpy())
        waiting.clear()

    for image in _images(meta):
        waiting.append(image)
        if len(waiting) == DECODED:
            pool()
    if waiting:
        pool()
    found = sum(map(len, out))
    if found != meta.total_frames:
        raise InputError(f"Dataset '{meta.repo_id}': {found} tactile images of {meta.total_frames}.")
    return np.concatenate(out)


def _images(meta: LeRobotDatasetMetadata) -> Iterator[np.ndarray]:
    """Tactile images uint8 (320, 240, 3) of all frames in order; raises InputError where one is missing."""
    files: dict[Path, list[int]] = {}  # file to the places of the frames wanted, in its own frames
    for i in range(meta.total_episodes):
        row = meta.episodes[i]
        start = round(row[f"videos/{TACTILE}/from_timestamp"] * meta.fps)
        length = row["dataset_to_index"] - row["dataset_from_index"]
        files.setdefault(meta.root / meta.get_video_file_path(i, TACTILE), []).extend(
            range(start, start + length)
        )
    for path, places in files.items():
        if places != sorted(places):
            raise InputError(f"'{path}': the episodes' frames do not follow one another.")
        wanted = iter(places)
        place = next(wanted)
        try:
            with av.open(str(path)) as container:
                for frame in container.decode(container.streams.video[0]):
                    if round(frame.time * meta.fps) == place:
                        yield frame.to_ndarray(format="rgb24")
                        place = next(wanted, None)
        except (OSError, ValueError) as error:
            raise InputError(f"'{path}' cannot be decoded ({error}); record the dataset again.") from error
