"""Where the episodes of a killed recording lie in its videos."""

import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from lerobot_robot_pneutac.lerobot_inside import DatasetInfo, get_video_info, update_chunk_file_indices
from pneutac_datasets.demonstrations.films import Film, film_of, frame_size, read_film
from pneutac_sim.errors import InputError
from pneutac_sim.files import flush

FILE_NUMBERS = re.compile(r"chunk-(\d+)/file-(\d+)\.\w+$")
PLACE = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")


@dataclass(frozen=True)
class Rows:
    """One episode's rows in a data file: `group` counts the file's row groups."""

    episode: int
    length: int
    file: Path
    group: int

    def table(self) -> pa.Table:
        table = pq.ParquetFile(self.file).read_row_group(self.group)
        return table.filter(pc.equal(table["episode_index"], self.episode))


def place_videos(
    root: Path, info: DatasetInfo, known: list[dict], found: list[Rows], remarks: list[str]
) -> tuple[dict[str, list[dict]], dict[int, str]]:
    """Where each episode lies in each camera's videos, all of which are opened.

    Returns:
        Camera to one place for each episode, as LeRobot's metadata state it, and episode to the reason why a
        video of it is missing.
    """
    places: dict[str, list[dict]] = {}
    lacking: dict[int, str] = {}
    for key in (k for k, f in info.features.items() if f["dtype"] == "video"):
        film = _Films(root, info, key)
        places[key] = [{f"videos/{key}/{n}": row.get(f"videos/{key}/{n}") for n in PLACE} for row in known]
        places[key] += film.place(known, found[len(known) :], remarks)
        for rows, place in zip(found, places[key], strict=True):
            try:
                film.look(rows, place)
            except InputError as e:
                lacking.setdefault(rows.episode, str(e))
    return places, lacking


class _Films:
    """One camera's videos, each opened once."""

    def __init__(self, root: Path, info: DatasetInfo, key: str):
        self.root, self.info, self.key = root, info, key
        self._films: dict[Path, Film | InputError] = {}

    def place(self, known: list[dict], new: list[Rows], remarks: list[str]) -> list[dict]:
        """Where episodes that are not known lie: one after another in the files after the last known one.

        How many episodes a missing or torn file held is not known, so that none is looked for after it.
        """
        numbers = (
            self._next(tuple(known[-1][f"videos/{self.key}/{n}"] for n in PLACE[:2])) if known else (0, 0)
        )
        out, at, begun = [], 0, False
        for rows in new:
            if begun:
                following = self._next(numbers)
                if self._ended(numbers, at, rows.length) and self._file(following).is_file():
                    numbers, at, begun = following, 0, False
            if not begun:
                _take_whole_one(self._file(numbers), rows.length, remarks)
                begun = True
            times = at / self.info.fps, (at + rows.length) / self.info.fps
            out.append({f"videos/{self.key}/{n}": v for n, v in zip(PLACE, (*numbers, *times), strict=True)})
            at += rows.length
        return out

    def look(self, rows: Rows, place: dict) -> None:
        """Raises InputError where the frames of an episode are not all in its video, or are damaged."""
        chunk, number, begin, _ = (place[f"videos/{self.key}/{n}"] for n in PLACE)
        if None in (chunk, number, begin):
            raise InputError(f"meta/episodes does not say where '{self.key}' of episode {rows.episode} is.")
        file = self._file((chunk, number))
        film = film_of(self._films, file)
        wanted = begin + np.arange(rows.length) / self.info.fps
        there = int((~film.lacks(wanted)).sum())
        if there < rows.length:
            raise InputError(f"{file} holds {there} of the {rows.length} frames of episode {rows.episode}.")
        frame_size(file, wanted[[0, -1]])

    def _ended(self, numbers: tuple[int, int], at: int, length: int) -> bool:
        """Whether a whole video has too few frames for one more episode."""
        try:
            film = film_of(self._films, self._file(numbers))
        except InputError:
            return False
        return not film.torn and len(film.times_s) - at < length

    def _file(self, numbers: tuple[int, int]) -> Path:
        path = self.info.video_path.format(video_key=self.key, chunk_index=numbers[0], file_index=numbers[1])
        return self.root / path

    def _next(self, numbers: tuple[int, int]) -> tuple[int, int]:
        return update_chunk_file_indices(*numbers, self.info.chunks_size)


def tell_of_videos(root: Path, info: DatasetInfo, videos: dict[str, list[dict]]) -> None:
    """Codec and size in `info.json`, which LeRobot writes after a dataset's first video."""
    for key, places in videos.items():
        known = info.features[key].get("info") or {}
        if places and "video.fps" not in known:
            info.features[key]["info"] = known | get_video_info(video_file(root, info, key, places[0]))


def video_file(root: Path, info: DatasetInfo, key: str, place: dict) -> Path:
    """The video of a place as `place_videos` gives it."""
    numbers = {f"{n}_index": place[f"videos/{key}/{n}_index"] for n in ("chunk", "file")}
    return root / info.video_path.format(video_key=key, **numbers)


def file_numbers(file: Path) -> tuple[int, int]:
    """Chunk and file that a name states; names compare as they were written."""
    chunk, number = FILE_NUMBERS.search(file.as_posix()).groups()
    return int(chunk), int(number)


def _take_whole_one(file: Path, least: int, remarks: list[str]) -> None:
    """A video that was torn while it was copied from another disk is taken from there."""
    if not file.is_file() or _count(file) >= least:
        return
    start = file.read_bytes()
    for source in Path(tempfile.gettempdir()).glob("tmp*.mp4"):
        with source.open("rb") as f:
            same = f.read(len(start)) == start
        if same and _count(source) >= least:
            shutil.copy(source, file)
            flush(file)
            remarks.append(f"{file.name} of {file.parents[1].name} was torn; {source} is the whole one.")
            return


def _count(video: Path) -> int:
    try:
        return len(read_film(video).times_s)
    except InputError:
        return 0
