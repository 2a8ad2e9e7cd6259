"""Where the episodes of a killed recording lie in its videos."""

import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import av
from lerobot.datasets.utils import DatasetInfo
from lerobot.datasets.video_utils import get_video_info

from pneutac_sim.files import flush

FILE_NUMBERS = re.compile(r"chunk-(\d+)/file-(\d+)\.\w+$")


@dataclass
class Rows:
    """One episode's rows in a data file: `group` counts the file's row groups."""

    episode: int
    length: int
    file: Path
    group: int


def place_videos(
    root: Path, info: DatasetInfo, known: list[dict], found: list[Rows], remarks: list[str]
) -> dict[str, list[dict]]:
    """Where each episode that is not known lies in each camera's videos; the list ends where they do."""
    keys = [k for k, f in info.features.items() if f["dtype"] == "video"]
    places: dict[str, list[dict]] = {key: [] for key in keys}
    for key in keys:
        last = (-1, -1)
        if known:
            last = tuple(known[-1][f"videos/{key}/{n}_index"] for n in ("chunk", "file"))
        files = sorted((root / "videos" / key).glob("chunk-*/file-*.mp4"))
        files = [f for f in files if file_numbers(f) > last]
        left, at, file = 0, 0, None
        for rows in found[len(known) :]:
            if left < rows.length:
                if not files:
                    break
                file, at = files.pop(0), 0
                left = _frames(file, rows.length, remarks)
                if left < rows.length:
                    break
            chunk_index, file_index = file_numbers(file)
            places[key].append(
                {
                    f"videos/{key}/chunk_index": chunk_index,
                    f"videos/{key}/file_index": file_index,
                    f"videos/{key}/from_timestamp": at / info.fps,
                    f"videos/{key}/to_timestamp": (at + rows.length) / info.fps,
                }
            )
            at, left = at + rows.length, left - rows.length
    return places


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


def _frames(file: Path, least: int, remarks: list[str]) -> int:
    """Frames of a video; one that was torn while it was copied from another disk is taken from there."""
    frames = _count(file)
    if frames >= least:
        return frames
    start = file.read_bytes()
    for source in Path(tempfile.gettempdir()).glob("tmp*.mp4"):
        with source.open("rb") as f:
            same = f.read(len(start)) == start
        if same and _count(source) >= least:
            shutil.copy(source, file)
            flush(file)
            remarks.append(f"{file.name} of {file.parents[1].name} was torn; {source} is the whole one.")
            return _count(file)
    return frames


def _count(video: Path) -> int:
    try:
        with av.open(str(video)) as container:
            stream = container.streams.video[0]
            return stream.frames or sum(1 for p in container.demux(stream) if p.size)
    except (av.FFmpegError, IndexError, OSError):
        return 0
