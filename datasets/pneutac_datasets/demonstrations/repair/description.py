"""Metadata and statistics of recovered episodes, by LeRobot's own functions."""

import contextlib
import shutil
import tempfile
from pathlib import Path

import av
import numpy as np
import pandas as pd
from lerobot.datasets import LeRobotDatasetMetadata

from lerobot_robot_pneutac.lerobot_inside import (
    DatasetInfo,
    aggregate_stats,
    cast_stats_to_numpy,
    compute_episode_stats,
    write_info,
    write_stats,
    write_tasks,
)
from pneutac_datasets.demonstrations.repair.parquet_footer import is_whole
from pneutac_datasets.demonstrations.repair.videos import Rows, file_numbers, video_file
from pneutac_sim.errors import InputError

WRITTEN = ("info.json", "stats.json", "tasks.parquet")  # by LeRobot, in `meta`


def begin_metadata(
    work: Path, root: Path, info: DatasetInfo, known: list[dict], remarks: list[str]
) -> LeRobotDatasetMetadata:
    """Metadata of the known episodes in a folder of its own, to which LeRobot appends."""
    for file in sorted((root / "meta" / "episodes").glob("chunk-*/file-*.parquet")):
        if known and is_whole(file):
            copy = work / file.relative_to(root)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, copy)
    for file in (root / "meta").iterdir():  # station.yaml, achieved_rate.json
        if file.is_file() and file.name not in WRITTEN:
            (work / "meta").mkdir(exist_ok=True)
            shutil.copy(file, work / "meta")
    tasks = _tasks(root, known, remarks)
    info.total_episodes, info.total_frames = len(known), sum(r["length"] for r in known)
    info.total_tasks, info.splits = len(tasks), {"train": f"0:{len(known)}"}
    write_info(info, work)
    if len(tasks):
        write_tasks(tasks, work)
    if known:
        write_stats(aggregate_stats([_stats(r) for r in known]), work)
    return LeRobotDatasetMetadata("local/repaired", root=work)


def _tasks(root: Path, known: list[dict], remarks: list[str]) -> pd.DataFrame:
    file = root / "meta" / "tasks.parquet"
    if is_whole(file):
        return pd.read_parquet(file)
    names = list(dict.fromkeys(task for row in known for task in row["tasks"]))
    if file.exists():
        remarks.append("tasks.parquet was torn; a task that no complete episode names is called `task N`.")
    return pd.DataFrame({"task_index": range(len(names))}, index=pd.Index(names, name="task", dtype=object))


def _stats(row: dict) -> dict:
    flat = {k.removeprefix("stats/"): v for k, v in row.items() if k.startswith("stats/")}
    return cast_stats_to_numpy(flat)


def describe(meta: LeRobotDatasetMetadata, root: Path, info: DatasetInfo, rows: Rows, video: dict) -> None:
    """Describes one episode again, with its statistics, as LeRobot does when it is saved."""
    table = rows.table()
    numbers = np.unique(table["task_index"])
    names = [] if meta.tasks is None else list(meta.tasks.index)
    names += [f"task {i}" for i in range(len(names), int(numbers.max()) + 1)]
    meta.save_episode_tasks(names)
    chunk, file = file_numbers(rows.file)
    begin = meta.total_frames
    place = {"data/chunk_index": chunk, "data/file_index": file}
    place |= {"dataset_from_index": begin, "dataset_to_index": begin + rows.length}
    with tempfile.TemporaryDirectory() as folder:
        values = {}
        for key, feature in info.features.items():
            if feature["dtype"] == "image":
                values[key] = _write_images(table[key].to_pylist(), Path(folder) / str(len(values)))
            elif feature["dtype"] == "video":
                path = video_file(root, info, key, video[key])
                first = round(video[key][f"videos/{key}/from_timestamp"] * info.fps)
                values[key] = _write_frames(path, first, rows.length, Path(folder) / str(len(values)))
            elif feature["dtype"] != "string":
                values[key] = np.array(table[key].to_pylist(), dtype=feature["dtype"])
        stats = compute_episode_stats(values, info.features)
    for key in video:
        place |= video[key]
    meta.save_episode(rows.episode, rows.length, [names[i] for i in numbers], stats, place)


def _write_images(cells: list[dict], folder: Path) -> list[str]:
    folder.mkdir()
    paths = [str(folder / f"{i}.png") for i in range(len(cells))]
    for path, cell in zip(paths, cells, strict=True):
        Path(path).write_bytes(cell["bytes"])
    return paths


def _write_frames(video: Path, first: int, length: int, folder: Path) -> list[str]:
    folder.mkdir()
    paths = []
    with contextlib.suppress(av.FFmpegError), av.open(str(video)) as container:
        for i, frame in enumerate(container.decode(video=0)):
            if first <= i < first + length:
                paths.append(str(folder / f"{i}.png"))
                frame.to_image().save(paths[-1], compress_level=1)
    if len(paths) < length:
        raise InputError(f"{video}: frame {first + len(paths)} cannot be decoded; restore the video.")
    return paths
