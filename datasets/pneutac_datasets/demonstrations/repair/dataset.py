"""Datasets whose recording was killed: every episode that lies on the disk is made readable again.

LeRobot 0.6 writes an episode's numbers (and images that are no video) as one row group of a Parquet file that
it ends only when the recording ends, then its videos, and keeps up to ten episodes' metadata in memory. After
a kill, numbers and videos are therefore there, and what says where they lie is not. It is made anew here.
"""

import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets.feature_utils import get_hf_features_from_features
from lerobot.datasets.utils import DatasetInfo

import datasets
from pneutac_datasets.demonstrations.repair.description import begin_metadata, describe
from pneutac_datasets.demonstrations.repair.parquet_footer import is_whole, mend
from pneutac_datasets.demonstrations.repair.videos import Rows, place_videos, tell_of_videos
from pneutac_sim.errors import InputError
from pneutac_sim.files import flush

ASIDE = "meta.before_repair"  # what was there, until the new one is in place


@dataclass(frozen=True)
class Repaired:
    """What a repair found.

    Attributes:
        episodes: that the dataset has now.
        frames: of them all.
        recovered: episodes that could not be read before.
        remarks: what was torn and what was done, one sentence each.
    """

    episodes: int
    frames: int
    recovered: int
    remarks: tuple[str, ...]


def repair_dataset(root: str | Path, like: str | Path | None = None) -> Repaired:
    """Makes a dataset whole whose recording was killed, so that it can be read and resumed offline.

    Args:
        root: the dataset's folder; nothing else may be writing there.
        like: a whole dataset of the same robot and frame rate, wanted only where `meta/info.json` is torn.

    Raises:
        InputError: the folder is no dataset of LeRobot, `info.json` is torn and `like` is missing or other.
    """
    root = Path(root)
    _finish_an_earlier_repair(root)
    info, remarks = _read_info(root, like)
    known = _known_episodes(root, remarks)
    found = _episodes_on_disk(root, info, remarks)
    before = len(known)
    if len(found) < before:
        raise InputError(f"'{root}' tells of {before} episodes, data/ holds {len(found)}; restore it.")
    videos = place_videos(root, info, known, found, remarks)
    complete = min([len(found), *(before + len(v) for v in videos.values())])
    if complete < len(found):
        remarks.append(f"Episode {complete} was being written and has no video; it is left out.")
        _drop(found[complete:], found[:complete], info)
    found = found[:complete]

    tell_of_videos(root, info, videos)
    with tempfile.TemporaryDirectory(dir=root, prefix=".repair-") as work:
        meta = begin_metadata(Path(work), root, info, known, remarks)
        for rows in found[before:]:
            describe(meta, root, info, rows, {k: v[rows.episode - before] for k, v in videos.items()})
        meta.finalize()
        _put_in_place(root, Path(work) / "meta")
    _clear(root, remarks)
    return Repaired(complete, sum(r.length for r in found), complete - before, tuple(remarks))


def _finish_an_earlier_repair(root: Path) -> None:
    if (root / ASIDE).is_dir():
        if not (root / "meta").exists():  # it was killed between its two renames
            (root / ASIDE).rename(root / "meta")
        else:
            shutil.rmtree(root / ASIDE)
    for work in root.glob(".repair-*"):
        shutil.rmtree(work)


def _read_info(root: Path, like: str | Path | None) -> tuple[DatasetInfo, list[str]]:
    file = root / "meta" / "info.json"
    if not (root / "meta").is_dir():
        raise InputError(f"'{root}' is no dataset of LeRobot: it has no folder meta.")
    try:
        return DatasetInfo.from_dict(json.loads(file.read_text())), []
    except (OSError, ValueError, TypeError, AttributeError) as e:
        if like is None:
            raise InputError(
                f"{file} is torn; give --like=DATASET, a whole dataset of the same robot and frame rate."
            ) from e
    try:
        info = DatasetInfo.from_dict(json.loads((Path(like) / "meta" / "info.json").read_text()))
    except (OSError, ValueError, TypeError, AttributeError) as e:
        raise InputError(f"like={like} is no whole dataset of LeRobot ({e}).") from e
    return info, [f"info.json was torn; robot, features and frame rate are those of {like}."]


def _known_episodes(root: Path, remarks: list[str]) -> list[dict]:
    """Metadata of the episodes that earlier sessions have ended; later files without an end are left out."""
    rows = []
    for file in sorted((root / "meta" / "episodes").glob("chunk-*/file-*.parquet")):
        if is_whole(file):
            rows += pq.read_table(file).to_pylist()
        else:
            remarks.append(f"{file.relative_to(root)} had no end; its episodes are described anew.")
    rows.sort(key=lambda r: r["episode_index"])
    if [r["episode_index"] for r in rows] != list(range(len(rows))):
        raise InputError(f"{root}/meta/episodes does not count its episodes from 0; restore it.")
    return rows


def _episodes_on_disk(root: Path, info: DatasetInfo, remarks: list[str]) -> list[Rows]:
    schema = _schema(info)
    found: list[Rows] = []
    for file in sorted((root / "data").glob("chunk-*/file-*.parquet")):
        if not is_whole(file):
            groups = mend(file, schema)
            remarks.append(f"{file.relative_to(root)} had no end; {groups} episodes of it are whole.")
            if not groups:
                file.unlink()
                continue
        parquet = pq.ParquetFile(file)
        for group in range(parquet.num_row_groups):
            table = parquet.read_row_group(group, columns=["episode_index"])
            for episode, length in zip(*np.unique(table["episode_index"], return_counts=True), strict=True):
                found.append(Rows(int(episode), int(length), file, group))
    episodes = [r.episode for r in found]
    if episodes != list(range(len(found))):
        raise InputError(f"{root}/data does not count its episodes from 0; restore what is missing there.")
    return found


def _schema(info: DatasetInfo) -> pa.Schema:
    features = get_hf_features_from_features(info.features)
    return datasets.Dataset.from_dict({key: [] for key in features}, features=features).data.schema


def _drop(rows: list[Rows], kept: list[Rows], info: DatasetInfo) -> None:
    """Takes the last episodes out of the data files."""
    for file in {r.file for r in rows}:
        groups = sum(r.file == file for r in kept)
        if groups:
            mend(file, _schema(info), groups)
        else:
            file.unlink()


def _put_in_place(root: Path, meta: Path) -> None:
    for file in meta.rglob("*"):
        flush(file)
    (root / "meta").rename(root / ASIDE)
    meta.rename(root / "meta")
    flush(root)
    shutil.rmtree(root / ASIDE)


def _clear(root: Path, remarks: list[str]) -> None:
    """Deletes the pictures of the episode that was not finished: the next one would take them for its own."""
    left = list((root / "images").glob("*/episode-*")) if (root / "images").is_dir() else []
    left += [f for f in root.glob("tmp*") if f.is_dir()]
    for folder in left:
        shutil.rmtree(folder)
    if left:
        remarks.append("Pictures of the unfinished episode are deleted; its numbers were in memory.")
