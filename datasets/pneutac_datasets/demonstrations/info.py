"""What a LeRobotDataset states of itself, and whether its files hold it; read without LeRobot.

LeRobot looks for what is missing on the Hub, and ends in errors of its own. `dataset_faults` opens before all
that LeRobot opens, and says what is wrong in sentences.
"""

import re
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import numpy as np

from pneutac_datasets.demonstrations.films import TOLERANCE_S, Film, film_of, frame_size
from pneutac_datasets.recording.image_file import read_image
from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import read_json, refuse_pointer
from pneutac_sim.pace import info_file, read_info, refuse_version

if TYPE_CHECKING:
    import pyarrow as pa

ROBOT = "pneutac"
STATE, ACTION = "observation.state", "action"
OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")  # LeRobot's, in every dataset
COUNTS = ("total_episodes", "total_frames", "total_tasks")
STATISTICS = ("min", "max", "mean", "std")
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"


def is_demonstrations(folder: str | Path) -> bool:
    """Whether a folder is a LeRobotDataset of a robot rather than a bench recording.

    One of another robot than this one that names a commanded pressure in kPa was measured on a bench.
    """
    file = Path(folder) / "meta" / "info.json"
    if not file.is_file():
        return False
    info = read_info(file)
    features = info["features"]
    if not {STATE, ACTION} & set(features):
        return False
    entries = {str(n) for f in features.values() for n in _names(f)} | set(features)
    measured = any(re.fullmatch(r"pressure_cmd_(\d+_)?kpa", n) for n in entries)
    return not (measured and info.get("robot_type") != ROBOT)


def _names(feature: dict) -> list:
    names = feature.get("names") or []
    names = next(iter(names.values()), []) if isinstance(names, dict) else names
    return names if isinstance(names, list) else []


def refuse_damaged(folder: str | Path) -> None:
    """Raises InputError with the first of `dataset_faults`, and where there is no dataset at all."""
    if faults := dataset_faults(Path(folder), read_info(info_file(folder))):
        raise InputError(faults[0])


def work_folder(out_root: Path) -> Path:
    """Where pieces of a new dataset lie until it is whole."""
    return out_root.with_name(out_root.name + ".work")


def check_new(out_root: Path, repo_id: str) -> None:
    """Raises InputError where a new dataset's folder exists, and no run is left to be tidied up there."""
    if out_root.exists() and not work_folder(out_root).exists():
        raise InputError(f"'{out_root}' exists; give a new folder for dataset '{repo_id}'.")


def dataset_faults(folder: Path, info: dict) -> list[str]:
    """One sentence for each thing for which LeRobot would not read a dataset, or read it wrongly.

    Every file is opened: numbers, tasks, episodes, statistics, and of each episode's videos or images the
    first and the last frame. `info` is as `read_info` gives it.
    """
    file = folder / "meta" / "info.json"
    try:
        refuse_version(file, info)
    except InputError as e:
        return [str(e)]
    found = _of_info(file, info)
    if found:
        return found  # what the files are to hold is not known
    repair = f"`pneutac repair --dataset={quote(str(folder))}`"
    try:
        tasks = _tasks(folder, info, repair)
        episodes = _episodes(folder, info, repair)
        _statistics(folder, info, repair)
        rows = _rows(folder, info, repair)
        _match(folder, info, tasks, episodes, rows, repair)
    except InputError as e:
        return [str(e)]
    return _pictures(folder, info, episodes, rows, repair)


def _of_info(file: Path, info: dict) -> list[str]:
    found = []
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < 1e4:
        found.append(f"{file}: 'fps' is {shown(fps)}; give the frames per second.")
    for name in COUNTS:
        count = info.get(name, 0)
        if isinstance(count, bool) or not isinstance(count, int) or count < 0:
            found.append(f"{file}: '{name}' is {shown(count)}; it must be a whole number.")
    for name in OWN:
        if name not in info["features"]:
            found.append(f"{file}: feature '{name}' is missing, which every LeRobotDataset has; restore it.")
    for key, feature in info["features"].items():
        shape = feature.get("shape")
        sizes = isinstance(shape, list) and all(isinstance(n, int) and n > 0 for n in shape) and shape
        if not isinstance(feature.get("dtype"), str) or not sizes:
            found.append(
                f"{file}: feature '{key}' lacks 'dtype' or 'shape', or they are damaged; restore it."
            )
    path = info.get("video_path")
    if _of_kind(info, "video") and not (isinstance(path, str) and "{video_key}" in path):
        found.append(f"{file}: 'video_path' is {shown(path)}; it must be \"{VIDEO_PATH}\".")
    return found


def _of_kind(info: dict, *kinds: str) -> list[str]:
    return [key for key, feature in info["features"].items() if feature["dtype"] in kinds]


def _read_parquet(file: Path, remedy: str, columns: list[str] | None = None, schema: bool = False):
    """A table, or its schema alone; raises InputError where it is missing or damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not file.is_file():
        raise InputError(f"{file} is missing; {remedy}.")
    refuse_pointer(file)
    try:
        return pq.read_schema(file) if schema else pq.read_table(file, columns=columns, partitioning=None)
    except (pa.ArrowException, OSError, ValueError) as e:
        raise InputError(f"{file} is cut short or damaged, and no Parquet file; {remedy}.") from e


def _tasks(folder: Path, info: dict, repair: str) -> set[int]:
    file = folder / "meta" / "tasks.parquet"
    remedy = f"restore it, or run {repair}, which names tasks by number"
    table = _read_parquet(file, remedy)
    if not {"task_index", "task"} <= set(table.column_names):
        raise InputError(f"{file} has no columns 'task' and 'task_index'; {remedy}.")
    if len(table) != info.get("total_tasks", 0):
        raise InputError(
            f"{file} has {len(table)} tasks and info.json counts {info.get('total_tasks', 0)}; run {repair}."
        )
    return set(table["task_index"].to_pylist())


def _episodes(folder: Path, info: dict, repair: str) -> list[dict]:
    files = sorted((folder / "meta" / "episodes").glob("*/*.parquet"))
    if not files:
        raise InputError(f"{folder / 'meta' / 'episodes'} holds no .parquet file; run {repair}.")
    wanted = ["episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index"]
    for key in _of_kind(info, "video"):
        wanted += [f"videos/{key}/{n}" for n in ("chunk_index", "file_index", "from_timestamp")]
    rows: list[dict] = []
    for file in files:
        table = _read_parquet(file, f"run {repair}")
        missing = [name for name in wanted if name not in table.column_names]
        if missing:
            raise InputError(
                f"{file} lacks the column '{missing[0]}'; delete meta/episodes and run {repair}."
            )
        rows += table.select(wanted).to_pylist()
    rows.sort(key=lambda row: (row["episode_index"] is None, row["episode_index"]))
    if [row["episode_index"] for row in rows] != list(range(len(rows))):
        raise InputError(
            f"{folder / 'meta' / 'episodes'} does not number its episodes from 0 on; restore what is missing."
        )
    if len(rows) != info.get("total_episodes", 0):
        raise InputError(
            f"{folder}: meta/episodes has {len(rows)} episodes and info.json counts"
            f" {info.get('total_episodes', 0)}; run {repair}."
        )
    return rows


def _statistics(folder: Path, info: dict, repair: str) -> None:
    file = folder / "meta" / "stats.json"
    if not file.is_file():
        raise InputError(f"{file} is missing; run {repair}.")
    stats = read_json(file)
    for key in (STATE, ACTION):
        if key not in info["features"]:
            continue
        mine, size = stats.get(key), info["features"][key]["shape"]
        for name in STATISTICS:
            values = mine.get(name) if isinstance(mine, dict) else None
            try:
                right = np.shape(np.asarray(values, float)) == tuple(size)
            except (TypeError, ValueError):
                right = False
            if not right:
                raise InputError(f"{file}: '{key}' lacks '{name}' of {size[0]} numbers; run {repair}.")


def _rows(folder: Path, info: dict, repair: str) -> dict[str, np.ndarray]:
    """LeRobot's own columns of all rows."""
    files = sorted((folder / "data").glob("*/*.parquet"))
    if not files:
        raise InputError(f"{folder / 'data'} holds no .parquet file; restore it.")
    wanted = {key: f for key, f in info["features"].items() if f["dtype"] != "video"}
    parts: dict[str, list] = {name: [] for name in OWN}
    for file in files:
        if not file.stat().st_size:
            raise InputError(f"{file} is empty; restore it.")
        whole = f"restore it, or run {repair}, which keeps its whole episodes"
        schema = _read_parquet(file, whole, schema=True)
        if set(schema.names) != set(wanted):
            missing, more = sorted(set(wanted) - set(schema.names)), sorted(set(schema.names) - set(wanted))
            what = f"lacks the column '{missing[0]}'" if missing else f"has a column '{more[0]}'"
            raise InputError(f"{file} {what}, unlike info.json; restore one of the two.")
        numbers = [key for key, f in wanted.items() if f["dtype"] not in ("image", "string")]
        table = _read_parquet(file, "restore it", numbers)
        for key in numbers:
            values = column(file, table, key, wanted[key]["shape"])
            if key in OWN:
                parts[key].append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}


def column(file: Path, table: "pa.Table", key: str, shape: list[int]) -> np.ndarray:
    """(n, ...) one column of a data file; raises InputError where it is not of numbers of that shape."""
    import pyarrow as pa

    values = table[key]
    try:
        if values.null_count:
            raise ValueError("an empty cell")
        if shape == [1] and not pa.types.is_nested(values.type):
            out = values.to_numpy().astype(float)
        else:
            out = np.array(values.to_pylist(), dtype=float).reshape(len(values), *shape)
    except (ValueError, TypeError) as e:
        raise InputError(f"{file}: the column '{key}' does not hold {shape} numbers in every row.") from e
    return out


def _match(
    folder: Path, info: dict, tasks: set[int], episodes: list[dict], rows: dict[str, np.ndarray], repair: str
) -> None:
    """Raises InputError where numbers, episodes and counts do not belong together."""
    lengths = [row["length"] for row in episodes]
    begins, total = np.cumsum([0, *lengths]).tolist(), len(rows["index"])
    for number, (row, begin, end) in enumerate(zip(episodes, begins, begins[1:], strict=False)):
        there = int((rows["episode_index"] == number).sum())
        if there != row["length"]:
            raise InputError(
                f"{folder}: data/ holds {there} rows of episode {number} and meta/episodes counts"
                f" {row['length']}; restore data/."
            )
        if (row["dataset_from_index"], row["dataset_to_index"]) != (begin, end):
            raise InputError(
                f"{folder}: meta/episodes places episode {number} in the rows {row['dataset_from_index']} to"
                f" {row['dataset_to_index']}, where {begin} to {end} are its; delete meta/episodes and run"
                f" {repair}."
            )
    for file, count in (("meta/episodes", begins[-1]), ("info.json", info.get("total_frames"))):
        if count != total:
            raise InputError(f"{folder}: data/ holds {total} rows and {file} counts {count}; run {repair}.")
    frame = np.concatenate([np.arange(n) for n in lengths]) if lengths else np.zeros(0)
    right = {"index": np.arange(total), "episode_index": np.repeat(range(len(lengths)), lengths)}
    for name, values in (right | {"frame_index": frame}).items():
        wrong = np.flatnonzero(rows[name] != values)
        if len(wrong):
            at = wrong[0]
            raise InputError(
                f"{folder}: row {at} of data/ has {name} {rows[name][at]:g} where {values[at]:g} is due; rows"
                " are missing or out of order: restore data/."
            )
    late = np.flatnonzero(np.abs(rows["timestamp"] - frame / info["fps"]) > TOLERANCE_S)
    if len(late):
        at = late[0]
        raise InputError(
            f"{folder}: row {at} of data/ has timestamp {rows['timestamp'][at]:.4f} s, and frame"
            f" {frame[at]:.0f} at {info['fps']:g} fps is {frame[at] / info['fps']:.4f} s; restore data/, or"
            " correct fps in info.json."
        )
    unknown = set(rows["task_index"].astype(int)) - tasks
    if unknown:
        raise InputError(
            f"{folder}: data/ has the task number {min(unknown)}, and meta/tasks.parquet none of that number;"
            " restore it."
        )


def _pictures(
    folder: Path, info: dict, episodes: list[dict], rows: dict[str, np.ndarray], repair: str
) -> list[str]:
    """One sentence for each video or column of images that is missing, damaged or of another size."""
    found: dict[str, str] = {}  # of a file the first fault
    films: dict[Path, Film | InputError] = {}
    for key in _of_kind(info, "video"):
        for number, row in enumerate(episodes):
            places = "chunk_index", "file_index", "from_timestamp"
            chunk, file_number, begin = (row[f"videos/{key}/{n}"] for n in places)
            path = key
            try:
                if None in (chunk, file_number, begin):
                    raise InputError(
                        f"{folder}: meta/episodes does not say where '{key}' of episode {number} is; delete"
                        f" meta/episodes and run {repair}."
                    )
                numbers = {"chunk_index": int(chunk), "file_index": int(file_number)}
                file = folder / (path := info["video_path"].format(video_key=key, **numbers))
                if not file.is_file():
                    drop = f"run {repair} --drop, which leaves its episodes out"
                    raise InputError(f"{file} is missing; put it back, or {drop}.")
                times = begin + rows["timestamp"][rows["episode_index"] == number]
                _look_at_video(film_of(films, file), file, times, number, repair)
                size = frame_size(file, times[[0, -1]])
                _refuse_size(f"{file}: the frames of '{key}'", size, info["features"][key]["shape"])
            except InputError as e:
                found.setdefault(path, str(e))
    ends = {0, *(row["dataset_to_index"] - 1 for row in episodes)}
    ends |= {row["dataset_from_index"] for row in episodes}
    for key in _of_kind(info, "image"):
        try:
            _look_at_images(folder, key, info["features"][key]["shape"], ends)
        except InputError as e:
            found.setdefault(key, str(e))
    return list(found.values())


def _look_at_video(film: Film, file: Path, times_s: np.ndarray, number: int, repair: str) -> None:
    lacks = film.lacks(times_s)
    if not lacks.any():
        return
    if film.torn or film.times_s[-1] < times_s[-1] - TOLERANCE_S:
        raise InputError(
            f"{file} breaks off: it holds {int((~lacks).sum())} of the {len(times_s)} frames of episode"
            f" {number}; restore it, or run {repair} --drop, which leaves such episodes out."
        )
    raise InputError(
        f"{file} has no frame at {times_s[lacks][0]:.4f} s, where meta/episodes (from_timestamp) puts one of"
        f" episode {number}; run {repair}, which counts the times again."
    )


def _refuse_size(what: str, size: tuple[int, int], shape: list[int]) -> None:
    """Raises InputError where an image has another height or width than `info.json` says."""
    given = shape[1:] if len(shape) == 3 and shape[0] in (1, 3) and shape[2] not in (1, 3) else shape[:2]
    if list(size) != list(given):
        raise InputError(f"{what} are {size[0]} x {size[1]} but info.json states {given[0]} x {given[1]}.")


def _look_at_images(folder: Path, key: str, shape: list[int], which: set[int]) -> None:
    import pyarrow.parquet as pq

    row = 0
    for file in sorted((folder / "data").glob("*/*.parquet")):
        for batch in pq.ParquetFile(file).iter_batches(batch_size=32, columns=[key]):
            for i in range(len(batch)):
                if row + i not in which:
                    continue
                cell = batch[0][i].as_py()
                content = cell.get("bytes") if isinstance(cell, dict) else None
                where = f"{file}: image '{key}' of row {row + i}"
                if not content:
                    raise InputError(f"{where} is missing; restore the file.")
                image = read_image(content, where)
                _refuse_size(f"{where} and others", image.shape[:2], shape)
            row += len(batch)
