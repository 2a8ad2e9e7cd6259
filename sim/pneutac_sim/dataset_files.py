"""A LeRobotDataset on the disk, and whether its files hold what it states; read without LeRobot.

LeRobot looks for what is missing on the Hub, and ends in errors of its own. `Files` opens before all that
LeRobot opens, and says what is wrong in sentences.
"""

import codecs
import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import numpy as np

from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import read_image, read_json, refuse_pointer
from pneutac_sim.pace import info_file, read_info, refuse_version

if TYPE_CHECKING:
    import pyarrow as pa

ROBOT = "pneutac"
STATE, ACTION = "observation.state", "action"
OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")  # LeRobot's, in every dataset
COUNTS = ("total_episodes", "total_frames", "total_tasks")
STATISTICS = ("min", "max", "mean", "std")
ROUNDED = 1e-3  # of a mean in float32
PLACE = ("chunk_index", "file_index", "from_timestamp")  # of an episode in a camera's videos
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
NOT_FINITE = "holds numbers that are not finite"
TOLERANCE_S = 1e-4  # LeRobot's, between the time of a row and that of its frame


@dataclass(frozen=True)
class Film:
    """What a video file holds."""

    times_s: np.ndarray  # (n,) times of the frames that are in the file to their last byte, ascending
    stated: int  # frames that its header promises

    @property
    def torn(self) -> bool:
        """Whether frames that the header promises are missing."""
        return len(self.times_s) < self.stated

    def lacks(self, wanted_s: np.ndarray) -> np.ndarray:
        """(k,) bool: at which of these times there is no frame within LeRobot's tolerance."""
        if not len(self.times_s):
            return np.ones(len(wanted_s), bool)
        after = np.searchsorted(self.times_s, wanted_s).clip(max=len(self.times_s) - 1)
        nearest = [np.abs(self.times_s[i] - wanted_s) for i in (after, np.maximum(after - 1, 0))]
        return np.minimum(*nearest) > TOLERANCE_S


def read_film(file: Path) -> Film:
    """Reads which frames a video holds, without decoding them.

    Raises InputError: it is missing, a pointer of Git LFS, or no video.
    """
    import av  # which the bench, whose recordings have no videos, does without

    if not file.is_file():
        raise InputError(f"{file} is missing.")
    refuse_pointer(file)
    times: list[float] = []
    stated = 0
    try:
        with _opened(file) as container:
            stream = container.streams.video[0]
            stated = stream.frames
            for packet in container.demux(stream):
                if packet.size and packet.pts is not None and not packet.is_corrupt:
                    times.append(float(packet.pts * stream.time_base))
    except (av.FFmpegError, IndexError, OSError) as e:
        if not times:
            raise InputError(f"{file} cannot be opened as a video; restore it.") from e
    return Film(np.sort(times), stated)


def film_of(films: dict[Path, Film | InputError], file: Path) -> Film:
    """A video, opened once; raises InputError where it cannot be."""
    if file not in films:
        try:
            films[file] = read_film(file)
        except InputError as e:
            films[file] = e
    film = films[file]
    if isinstance(film, InputError):
        raise film
    return film


def frame_size(file: Path, times_s: Sequence[float]) -> tuple[int, int]:
    """Decodes the frames at these times; returns their height and width.

    Raises InputError: one of them cannot be decoded.
    """
    import av

    try:
        with _opened(file) as container:
            stream = container.streams.video[0]
            for time_s in times_s:
                container.seek(round(time_s / stream.time_base), stream=stream)
                decoded = (f for f in container.decode(stream) if f.time is not None)
                frame = next(f for f in decoded if f.time > time_s - TOLERANCE_S)
    except (av.FFmpegError, StopIteration, OSError) as e:
        raise InputError(f"{file}: the frame at {time_s:.2f} s cannot be decoded.") from e
    return frame.height, frame.width


@contextlib.contextmanager
def _opened(file: Path) -> Iterator:
    """A video as PyAV's container, while libav's own messages about damage stay silent."""
    import av

    av.logging.set_libav_level(av.logging.PANIC)
    try:
        with av.open(str(file)) as container:
            yield container
    finally:
        av.logging.set_libav_level(av.logging.INFO)


class Files:
    """A LeRobotDataset on the disk; raises InputError where there is none or its `info.json` is damaged.

    Attributes:
        folder: of the dataset.
        info: content of its `info.json`, as `read_info` gives it.
        rows: LeRobot's own columns of all rows, state and action, once `damage` has read them.
    """

    def __init__(self, folder: str | Path):
        self.folder, self.file = Path(folder), info_file(folder)
        self.info, self.rows = read_info(self.file), {}
        self._repair = f"`pneutac repair --dataset={quote(str(folder))}`"

    def refuse_damaged(self) -> None:
        """Raises InputError with the first sentence of `damage`."""
        if self.damage:
            raise InputError(self.damage[0])

    @cached_property
    def damage(self) -> list[str]:
        """One sentence for each thing for which LeRobot would not read a dataset, or read it wrongly.

        Every file is opened: numbers, tasks, episodes, statistics, and of each episode's videos or images the
        first and the last frame.
        """
        try:
            refuse_version(self.file, self.info)
            if found := self._of_info():
                return found  # what the files are to hold is not known
            if not (self.info.get("total_episodes") or any(self.folder.glob("data/*/*.parquet"))):
                raise InputError(f"{self.folder} holds no episode; delete it and record again.")
            tasks, self._episodes = self._read_tasks(), self._read_episodes()
            self.rows = self._read_rows()
            self._check_statistics()
            self._match(tasks)
        except InputError as e:
            return [str(e)]
        return self._pictures()

    def refuse_not_finite(self) -> None:
        """Raises InputError where the state or the action of an episode holds NaN or infinity."""
        self.refuse_damaged()
        numbers = [self.rows[key].reshape(len(self.rows["index"]), -1) for key in (STATE, ACTION)]
        rows = self.rows["episode_index"][~np.isfinite(np.hstack(numbers)).all(1)]
        if broken := np.unique(rows).astype(int).tolist():
            raise InputError(f"{self.folder}: {leave_out(broken, NOT_FINITE)}")

    def _of_info(self) -> list[str]:
        found, info = [], self.info
        fps = info.get("fps")
        if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < 1e4:
            found.append(f"{self.file}: 'fps' is {shown(fps)}; give the frames per second.")
        for name in COUNTS:
            count = info.get(name, 0)
            if isinstance(count, bool) or not isinstance(count, int) or count < 0:
                found.append(f"{self.file}: '{name}' is {shown(count)}; it must be a whole number.")
        for name in (n for n in OWN if n not in info["features"]):
            what = f"feature '{name}' is missing, which every LeRobotDataset has"
            found.append(f"{self.file}: {what}; restore it.")
        chunk = info.get("chunks_size", 1)
        if isinstance(chunk, bool) or not isinstance(chunk, int) or chunk < 1:
            found.append(f"{self.file}: 'chunks_size' is {shown(chunk)}; LeRobot writes 1000.")
        if self.file.read_bytes().startswith(codecs.BOM_UTF8):
            found.append(f"{self.file} begins with a byte order mark; save it as UTF-8 without one.")
        for key, feature in info["features"].items():
            shape = feature.get("shape")
            sizes = isinstance(shape, list) and all(isinstance(n, int) and n > 0 for n in shape) and shape
            if not isinstance(feature.get("dtype"), str) or not sizes:
                what = f"feature '{key}' lacks 'dtype' or 'shape', or they are damaged"
                found.append(f"{self.file}: {what}; restore it.")
            elif key in (STATE, ACTION) and feature["dtype"] != "float32":
                found.append(f"{self.file}: 'dtype' of '{key}' is '{feature['dtype']}'; it must be float32.")
            elif not isinstance(feature.get("info", {}), dict | None):
                found.append(f"{self.file}: 'info' of '{key}' is {shown(feature['info'])}; take it out.")
        path = info.get("video_path")
        if not found and self._of_kind("video") and path != VIDEO_PATH:
            found.append(f"{self.file}: 'video_path' is {shown(path)}; it must be \"{VIDEO_PATH}\".")
        return found

    def _of_kind(self, kind: str) -> list[str]:
        return [key for key, feature in self.info["features"].items() if feature["dtype"] == kind]

    def _parquets(self, folder: str, remedy: str) -> list[Path]:
        files = sorted((self.folder / folder).glob("*/*.parquet"))
        if not files:
            raise InputError(f"{self.folder / folder} holds no .parquet file; {remedy}.")
        return files

    def _read_tasks(self) -> set[int]:
        file, count = self.folder / "meta" / "tasks.parquet", self.info.get("total_tasks", 0)
        remedy = f"restore it, or run {self._repair}, which names tasks by number"
        table = _read_parquet(file, remedy)
        if not {"task_index", "task"} <= set(table.column_names):
            raise InputError(f"{file} has no columns 'task' and 'task_index'; {remedy}.")
        if len(table) != count:
            raise InputError(
                f"{file} has {len(table)} tasks and info.json counts {count}; run {self._repair}."
            )
        return set(table["task_index"].to_pylist())

    def _read_episodes(self) -> list[dict]:
        folder, count = self.folder / "meta" / "episodes", self.info.get("total_episodes", 0)
        wanted = ["episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index"]
        wanted += [f"videos/{key}/{n}" for key in self._of_kind("video") for n in PLACE]
        rows: list[dict] = []
        for file in self._parquets("meta/episodes", f"run {self._repair}"):
            table = _read_parquet(file, f"run {self._repair}")
            if missing := [name for name in wanted if name not in table.column_names]:
                remedy = f"delete meta/episodes and run {self._repair}"
                raise InputError(f"{file} lacks the column '{missing[0]}'; {remedy}.")
            rows += table.select(wanted).to_pylist()
        rows.sort(key=lambda row: (row["episode_index"] is None, row["episode_index"]))
        if [row["episode_index"] for row in rows] != list(range(len(rows))):
            raise InputError(f"{folder} does not number its episodes from 0 on; restore what is missing.")
        if len(rows) != count:
            what = f"meta/episodes has {len(rows)} episodes and info.json counts {count}"
            raise InputError(f"{self.folder}: {what}; run {self._repair}.")
        return rows

    def _check_statistics(self) -> None:
        file = self.folder / "meta" / "stats.json"
        if not file.is_file():
            raise InputError(f"{file} is missing; run {self._repair}.")
        stats = read_json(file)
        features = self.info["features"]
        sizes = {k: features[k]["shape"] for k in (STATE, ACTION) if k in features}
        for key in self._of_kind("video") + self._of_kind("image"):  # without them lerobot-train fails
            sizes[key] = [min(features[key]["shape"]), 1, 1]  # of its channels
        for key, size in sizes.items():
            mine = stats.get(key)
            for name in STATISTICS:
                values = mine.get(name) if isinstance(mine, dict) else None
                try:
                    right = np.shape(np.asarray(values, float)) == tuple(size)
                except (TypeError, ValueError):
                    right = False
                if not right:
                    what = f"'{key}' lacks '{name}' of {size[0]} numbers"
                    raise InputError(f"{file}: {what}; run {self._repair}.")
            low, high, mean, std = (np.asarray(mine[name], float) for name in STATISTICS)
            if not np.isfinite(self.rows.get(key, 0.0)).all():
                continue  # theirs are not either, and of these episodes there is a sentence
            if not ((low <= mean + ROUNDED) & (mean <= high + ROUNDED) & (0 <= std) & (std < np.inf)).all():
                what = f"'{key}' has a mean outside its 'min' and 'max', or a number that is not finite"
                raise InputError(f"{file}: {what}; delete it and run {self._repair}.")

    def _read_rows(self) -> dict[str, np.ndarray]:
        wanted = {key: f for key, f in self.info["features"].items() if f["dtype"] != "video"}
        numbers = [key for key, f in wanted.items() if f["dtype"] not in ("image", "string")]
        parts: dict[str, list] = {name: [] for name in numbers if name in (*OWN, STATE, ACTION)}
        for file in self._parquets("data", "restore it"):
            if not file.stat().st_size:
                raise InputError(f"{file} is empty; restore it.")
            names = set(_read_parquet(file, "restore it", schema=True).names)
            if names != set(wanted):
                missing, more = sorted(set(wanted) - names), sorted(names - set(wanted))
                what = f"lacks the column '{missing[0]}'" if missing else f"has a column '{more[0]}'"
                raise InputError(f"{file} {what}, unlike info.json; restore one of the two.")
            table = _read_parquet(file, "restore it", numbers)
            for key in numbers:
                values = _column(file, table, key, wanted[key]["shape"])
                if key in parts:
                    parts[key].append(values)
        return {name: np.concatenate(values) for name, values in parts.items()}

    def _match(self, tasks: set[int]) -> None:
        """Raises InputError where numbers, episodes and counts do not belong together."""
        folder, rows, fps = self.folder, self.rows, self.info["fps"]
        lengths = [row["length"] for row in self._episodes]
        begins, total = np.cumsum([0, *lengths]).tolist(), len(rows["index"])
        for number, (row, begin, end) in enumerate(zip(self._episodes, begins, begins[1:], strict=False)):
            there = int((rows["episode_index"] == number).sum())
            if there != row["length"]:
                raise InputError(
                    f"{folder}: data/ holds {there} rows of episode {number} and meta/episodes counts"
                    f" {row['length']}; restore data/."
                )
            if (row["dataset_from_index"], row["dataset_to_index"]) != (begin, end):
                raise InputError(
                    f"{folder}: meta/episodes places episode {number} in the rows"
                    f" {row['dataset_from_index']} to {row['dataset_to_index']}, where {begin} to {end} are"
                    f" its; delete meta/episodes and run {self._repair}."
                )
        for file, count in (("meta/episodes", begins[-1]), ("info.json", self.info.get("total_frames"))):
            if count != total:
                what = f"data/ holds {total} rows and {file} counts {count}"
                raise InputError(f"{folder}: {what}; run {self._repair}.")
        frame = np.concatenate([np.arange(n) for n in lengths]) if lengths else np.zeros(0)
        right = {"index": np.arange(total), "episode_index": np.repeat(range(len(lengths)), lengths)}
        for name, values in (right | {"frame_index": frame}).items():
            if len(wrong := np.flatnonzero(rows[name] != values)):
                at = wrong[0]
                raise InputError(
                    f"{folder}: row {at} of data/ has {name} {rows[name][at]:g} where {values[at]:g} is due;"
                    " rows are missing or out of order: restore data/."
                )
        if len(late := np.flatnonzero(np.abs(rows["timestamp"] - frame / fps) > TOLERANCE_S)):
            at = late[0]
            raise InputError(
                f"{folder}: row {at} of data/ has timestamp {rows['timestamp'][at]:.4f} s, and frame"
                f" {frame[at]:.0f} at {fps:g} fps is {frame[at] / fps:.4f} s; restore data/, or"
                " correct fps in info.json."
            )
        if unknown := set(rows["task_index"].astype(int)) - tasks:
            what = f"data/ has the task number {min(unknown)}, and meta/tasks.parquet none of that number"
            raise InputError(f"{folder}: {what}; restore it.")

    def _pictures(self) -> list[str]:
        """One sentence for each video or column of images that is missing, damaged or of another size."""
        found: dict[str, str] = {}  # of a file the first fault
        films: dict[Path, Film | InputError] = {}
        for key in self._of_kind("video"):
            for number, row in enumerate(self._episodes):
                place, path = [row[f"videos/{key}/{n}"] for n in PLACE], key
                try:
                    if None in place:
                        raise InputError(
                            f"{self.folder}: meta/episodes does not say where '{key}' of episode {number} is;"
                            f" delete meta/episodes and run {self._repair}."
                        )
                    numbers = {"chunk_index": int(place[0]), "file_index": int(place[1])}
                    path = self.info["video_path"].format(video_key=key, **numbers)
                    self._look_at_video(films, self.folder / path, key, number, place[2])
                except InputError as e:
                    found.setdefault(path, str(e))
        for key in self._of_kind("image"):
            try:
                self._look_at_images(key)
            except InputError as e:
                found.setdefault(key, str(e))
        return list(found.values())

    def _look_at_video(
        self, films: dict[Path, Film | InputError], file: Path, key: str, number: int, begin_s: float
    ) -> None:
        """Raises InputError where an episode's frames are not all in a video, or cannot be decoded."""
        drop = f"run {self._repair[:-1]} --drop`, which leaves"
        if not file.is_file():
            raise InputError(f"{file} is missing; put it back, or {drop} its episodes out.")
        times_s = begin_s + self.rows["timestamp"][self.rows["episode_index"] == number]
        film = film_of(films, file)
        lacks = film.lacks(times_s)
        if lacks.any() and (film.torn or film.times_s[-1] < times_s[-1] - TOLERANCE_S):
            there = f"{int((~lacks).sum())} of the {len(times_s)} frames of episode {number}"
            raise InputError(f"{file} breaks off: it holds {there}; restore it, or {drop} such episodes out.")
        if lacks.any():
            raise InputError(
                f"{file} has no frame at {times_s[lacks][0]:.4f} s, where meta/episodes (from_timestamp) puts"
                f" one of episode {number}; run {self._repair}, which counts the times again."
            )
        self._refuse_size(f"{file}: the frames of '{key}'", frame_size(file, times_s[[0, -1]]), key)

    def _look_at_images(self, key: str) -> None:
        """The same of a column of images, of which the first and last of each episode are decoded."""
        import pyarrow.parquet as pq

        row, which = 0, {0}
        for episode in self._episodes:
            which |= {episode["dataset_from_index"], episode["dataset_to_index"] - 1}
        for file in self._parquets("data", "restore it"):
            for batch in pq.ParquetFile(file).iter_batches(batch_size=32, columns=[key]):
                for i in (i for i in range(len(batch)) if row + i in which):
                    cell = batch[0][i].as_py()
                    content = cell.get("bytes") if isinstance(cell, dict) else None
                    where = f"{file}: image '{key}' of row {row + i}"
                    if not content:
                        raise InputError(f"{where} is missing; restore the file.")
                    self._refuse_size(f"{where} and others", read_image(content, where).shape[:2], key)
                row += len(batch)

    def _refuse_size(self, what: str, size: tuple[int, int], key: str) -> None:
        """Raises InputError where an image has another height or width than `info.json` says."""
        shape = self.info["features"][key]["shape"]
        first = len(shape) == 3 and shape[0] in (1, 3) and shape[2] not in (1, 3)  # channels
        given = shape[1:] if first else shape[:2]
        if list(size) != list(given):
            there, stated = f"{size[0]} x {size[1]}", f"{given[0]} x {given[1]}"
            raise InputError(f"{what} are {there} but info.json states {stated}.")


def leave_out(which: list[int], fault: str) -> str:
    """The sentence on episodes that have a fault, and how LeRobot takes them out of a dataset."""
    return (
        f"{f'Episode {which[0]}' if len(which) == 1 else f'Each of the episodes {which}'} {fault};"
        " leave out with lerobot-edit-dataset --operation.type=delete_episodes"
        f' --operation.episode_indices="{which}".'
    )


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


def _column(file: Path, table: "pa.Table", key: str, shape: list[int]) -> np.ndarray:
    """(n, ...) one column of a data file; raises InputError where it is not of numbers of that shape."""
    import pyarrow as pa

    values = table[key]
    try:
        if values.null_count:
            raise ValueError("an empty cell")
        if shape == [1] and not pa.types.is_nested(values.type):
            return values.to_numpy().astype(float)
        return np.array(values.to_pylist(), dtype=float).reshape(len(values), *shape)
    except (ValueError, TypeError) as e:
        raise InputError(f"{file}: the column '{key}' does not hold {shape} numbers in every row.") from e
