"""Datasets whose recording was killed: every episode that lies on the disk is made readable again.

LeRobot 0.6 writes an episode's numbers (and images that are no video) as one row group of a Parquet file that
it ends only when the recording ends, then its videos, and keeps up to ten episodes' metadata in memory. After
a kill, numbers and videos are therefore there, and what says where they lie is not. It is made again here.

Everything is made in a folder of its own and takes its place at the end: a refusal changes nothing. What is
taken out of the dataset moves to its folder `left_out`.
"""

import contextlib
import errno
import json
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from lerobot.datasets import LeRobotDatasetMetadata

import datasets
from lerobot_robot_pneutac.lerobot_inside import (
    DatasetInfo,
    aggregate_stats,
    cast_stats_to_numpy,
    compute_episode_stats,
    get_hf_features_from_features,
    get_video_info,
    update_chunk_file_indices,
    write_info,
    write_stats,
    write_table_one_row_group_per_episode,
    write_tasks,
)
from pneutac_datasets.demonstrations.parquet_footer import fix_footer, is_whole
from pneutac_sim.dataset_files import Film, film_of, frame_size, read_film
from pneutac_sim.errors import InputError
from pneutac_sim.files import flush, refuse_pointer, write_json, write_text
from pneutac_sim.pace import OUTCOME_FILE, PACE_FILE, PROVENANCE, refuse_version

BACKUP = "meta.before_repair"  # what was there, until the new one is in place
LEFT_OUT = "left_out"  # numbers and pictures of episodes without a video, which no reader opens
WRITTEN = ("info.json", "stats.json", "tasks.parquet")  # by LeRobot, in `meta`
FILE_NUMBERS = re.compile(r"chunk-(\d+)/file-(\d+)\.\w+$")
PLACE = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
Place = tuple  # of an episode in one camera's videos: its numbers as `PLACE` names them
NOT_WRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)


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


@dataclass(frozen=True)
class Repaired:
    """What a repair found."""

    episodes: int  # that the dataset has now
    frames: int  # of them all
    recovered: int  # episodes that could not be read before
    remarks: tuple[str, ...]  # what was torn and what was done, one sentence each


def repair_dataset(root: str | Path, like: str | Path | None = None, drop: bool = False) -> Repaired:
    """Makes a dataset whole whose recording was killed, so that it can be read and resumed offline.

    Nothing else may be writing in `root`. `like`, a whole dataset of the same robot and frame rate, is wanted
    only where `meta/info.json` is torn; with `drop` episodes whose videos are missing are left out, and their
    numbers move to `left_out`. Raises InputError: the folder is no dataset of LeRobot or cannot be written,
    `info.json` is torn and `like` is missing or other, or videos are missing and `drop` is False. Nothing is
    changed then.
    """
    root = Path(root)
    if not ((root / "meta").is_dir() or (root / BACKUP).is_dir()):
        raise InputError(f"'{root}' is no dataset of LeRobot: it has no folder meta.")
    with _work_folder(root) as work:
        info, remarks = _read_info(root, like)
        known = _known_episodes(root, remarks)
        found = _episodes_on_disk(root, work, info, remarks)
        _refuse_lost_rows(root, known, found)
        places, lacking = place_videos(root, info, known, found, remarks)
        before = len(known)
        if lacking and known:
            again, none = place_videos(root, info, [], found, [])
            if not none:
                known, places, lacking = [], again, {}
                remarks.append("meta/episodes did not fit the videos; all episodes are described again.")
        if lacking:
            _refuse_lacking(root, found, lacking, before, drop, remarks)
            if min(lacking) < before:
                known = []  # what follows is numbered and described again
            found, places = _without(work, found, places, set(lacking))
        describe_videos(root, info, places)
        meta = begin_metadata(work, root, info, known, remarks)
        for rows in found[len(known) :]:
            describe(meta, root, info, rows, {k: v[rows.episode] for k, v in places.items()})
        meta.finalize()
        _number_anew(work / "meta", [e for e in range(len(found) + len(lacking)) if e not in lacking])
        _put_in_place(root, work)
        _clear(root, set(lacking), remarks)
    recovered = len(found) - (before - sum(e < before for e in lacking))
    return Repaired(len(found), sum(r.length for r in found), recovered, tuple(remarks))


@contextmanager
def _work_folder(root: Path) -> Iterator[Path]:
    """A folder in the dataset for all that is made; an earlier repair that was killed is finished before."""
    try:
        if (root / BACKUP).is_dir():
            if not (root / "meta").exists():  # it was killed between its two renames
                (root / BACKUP).rename(root / "meta")
            else:
                shutil.rmtree(root / BACKUP)
        for work in root.glob(".repair-*"):
            shutil.rmtree(work)
        with tempfile.TemporaryDirectory(dir=root, prefix=".repair-") as work:
            yield Path(work)
    except OSError as e:
        if e.errno not in NOT_WRITABLE:
            raise
        raise InputError(
            f"'{root}' cannot be written ({e.strerror}); copy the dataset to where you may write and repeat."
        ) from e


def _read_info(root: Path, like: str | Path | None) -> tuple[DatasetInfo, list[str]]:
    file = root / "meta" / "info.json"
    try:
        return _info(file), []
    except InputError:
        raise
    except (OSError, ValueError, TypeError, AttributeError) as e:
        if file.is_file():
            refuse_pointer(file)
        if like is None:
            raise InputError(
                f"{file} is torn; give --like=DATASET, a whole dataset of the same robot and frame rate."
            ) from e
    try:
        info = _info(Path(like) / "meta" / "info.json")
    except (OSError, ValueError, TypeError, AttributeError) as e:
        raise InputError(f"like={like} is no whole dataset of LeRobot ({e}).") from e
    return info, [f"info.json was torn; robot, features and frame rate are those of {like}."]


def _info(file: Path) -> DatasetInfo:
    content = json.loads(file.read_text(encoding="utf-8"))
    refuse_version(file, content)
    return DatasetInfo.from_dict(content)


def _known_episodes(root: Path, remarks: list[str]) -> list[dict]:
    """Metadata of the episodes that earlier sessions have ended; later files without an end are left out."""
    rows = []
    for file in sorted((root / "meta" / "episodes").glob("chunk-*/file-*.parquet")):
        refuse_pointer(file)
        if is_whole(file):
            rows += pq.read_table(file).to_pylist()
        else:
            remarks.append(f"{file.relative_to(root)} had no end; its episodes are described again.")
    rows.sort(key=lambda r: r["episode_index"])
    if [r["episode_index"] for r in rows] != list(range(len(rows))):
        raise InputError(f"{root}/meta/episodes does not count its episodes from 0; restore it.")
    return rows


def _episodes_on_disk(root: Path, work: Path, info: DatasetInfo, remarks: list[str]) -> list[Rows]:
    """Every episode whose rows are complete; files without an end are given one in the work folder."""
    features = get_hf_features_from_features(info.features)
    schema = datasets.Dataset.from_dict({key: [] for key in features}, features=features).data.schema
    found: list[Rows] = []
    for file in sorted((root / "data").glob("chunk-*/file-*.parquet")):
        refuse_pointer(file)
        if not is_whole(file):
            source, file = file, work / file.relative_to(root)
            file.parent.mkdir(parents=True, exist_ok=True)
            groups, cut = fix_footer(source, schema, file)
            remarks.append(f"{source.relative_to(root)} had no end; {groups} episodes of it are whole.")
            if cut:  # a part of an episode
                (work / LEFT_OUT).mkdir(exist_ok=True)
                shutil.copy(source, work / LEFT_OUT / f"torn-{source.parent.name}-{source.name}")
            if not groups:
                file.touch()  # nothing of it stays
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


def _refuse_lost_rows(root: Path, known: list[dict], found: list[Rows]) -> None:
    """Raises InputError where data/ holds fewer rows than the metadata count."""
    if len(found) < len(known):
        raise InputError(
            f"'{root}': meta/episodes has {len(known)} episodes, data/ holds {len(found)}; restore data/."
        )
    for row, rows in zip(known, found, strict=False):
        if row["length"] != rows.length:
            raise InputError(
                f"'{root}': data/ holds {rows.length} of the {row['length']} rows of episode {rows.episode};"
                " restore data/."
            )


def _refuse_lacking(
    root: Path, found: list[Rows], lacking: dict[int, str], before: int, drop: bool, remarks: list[str]
) -> None:
    """Raises InputError where videos are missing that nobody wants to leave out."""
    which = sorted(lacking)
    frames, last, one = sum(found[e].length for e in which), len(found) - 1, len(which) == 1
    if which == [last] and last >= before and _was_being_written(root, last):
        remarks.append(
            f"Episode {last} was being written and has no video; it is left out, its numbers are in"
            f" {LEFT_OUT}/."
        )
        return
    numbers = f"episode {which[0]}" if one else f"episodes {', '.join(map(str, which))}"
    reasons = " ".join(dict.fromkeys(lacking[e] for e in which))
    if not drop:
        raise InputError(
            f"'{root}': the videos of {numbers} ({frames} frames) are missing: {reasons} Nothing is changed."
            f" Put the videos back and repeat, or give --drop, which leaves {'it' if one else 'them'} out and"
            f" moves the numbers to {LEFT_OUT}/."
        )
    remarks.append(f"{reasons} Without {numbers}: the numbers are in {LEFT_OUT}/.")


def _was_being_written(root: Path, episode: int) -> bool:
    """Whether LeRobot has left the pictures or the new video of this episode, which it deletes at its end."""
    left = [*root.glob(f"images/*/episode-{episode:06d}"), *root.glob(f"tmp*/*_{episode:03d}.mp4")]
    return bool(left) or (episode > 0 and any(root.glob("tmp*/*_streaming.mp4")))


def _without(
    work: Path, found: list[Rows], places: dict[str, list[Place]], dropped: set[int]
) -> tuple[list[Rows], dict[str, list[Place]]]:
    """The episodes that stay, numbered from 0; those that are dropped become files of their own."""
    stay: list[Rows] = []
    root, first_row = work.parent, 0
    (work / LEFT_OUT).mkdir(exist_ok=True)
    for file in dict.fromkeys(r.file for r in found):
        mine = [r for r in found if r.file == file]
        if mine[-1].episode < min(dropped):
            stay, first_row = [*stay, *mine], first_row + sum(r.length for r in mine)
            continue
        out, tables = work / file.relative_to(work if file.is_relative_to(work) else root), []
        out.parent.mkdir(parents=True, exist_ok=True)
        for rows in mine:
            table = rows.table()
            if rows.episode in dropped:
                pq.write_table(table, work / LEFT_OUT / f"episode-{rows.episode:06d}.parquet")
                continue
            numbers = {"episode_index": np.full(rows.length, len(stay))}
            for name, values in (numbers | {"index": first_row + np.arange(rows.length)}).items():
                at = table.schema.get_field_index(name)
                field = table.schema.field(at)
                table = table.set_column(at, field, pa.array(values, field.type))
            stay.append(replace(rows, episode=len(stay), file=out, group=len(tables)))
            tables.append(table)
            first_row += rows.length
        if tables:
            write_table_one_row_group_per_episode(pa.concat_tables(tables), out)
        else:
            out.write_bytes(b"")
    return stay, {k: [p for e, p in enumerate(v) if e not in dropped] for k, v in places.items()}


def _number_anew(meta: Path, stay: list[int]) -> None:
    """Numbers what is stored of single episodes as them: `stay[k]` has become `k`, others are gone."""
    for file in (meta / name for name in (OUTCOME_FILE, PACE_FILE) if (meta / name).is_file()):
        with contextlib.suppress(ValueError, AttributeError):  # a damaged one, as its readers say
            old = {int(e): each for e, each in json.loads(file.read_text(encoding="utf-8")).items()}
            write_json(file, {str(k): old[e] for k, e in enumerate(stay) if e in old})
    if (file := meta / PROVENANCE).is_file():  # a line an episode
        lines = dict(enumerate(file.read_text(encoding="utf-8").splitlines()))
        with contextlib.suppress(ValueError):
            left = [json.loads(lines[e]) | {"episode": k} for k, e in enumerate(stay) if e in lines]
            write_text(file, "".join(json.dumps(line) + "\n" for line in left))


def _put_in_place(root: Path, work: Path) -> None:
    for file in work.rglob("*"):
        flush(file)
    left_out = list((work / LEFT_OUT).glob("*"))
    for file in left_out:
        (root / LEFT_OUT).mkdir(exist_ok=True)
        file.replace(_free(root / LEFT_OUT / file.name))
    for file in sorted((work / "data").rglob("*.parquet")):
        old = root / file.relative_to(work)
        if file.stat().st_size:
            file.replace(old)
        else:
            old.unlink()
    (root / "meta").rename(root / BACKUP)
    (work / "meta").rename(root / "meta")
    flush(root)
    shutil.rmtree(root / BACKUP)


def _free(file: Path) -> Path:
    """A name that no earlier repair has taken."""
    names = (file.with_name(f"{file.stem}-{i}{file.suffix}") for i in range(1, 10_000))
    return file if not file.exists() else next(f for f in names if not f.exists())


def _clear(root: Path, left_out: set[int], remarks: list[str]) -> None:
    """Takes away the pictures of unfinished episodes: the next one would take them for its own.

    Those of episodes whose numbers are in `left_out` go there; others have no numbers, and are deleted.
    """
    films = [f for f in root.glob("tmp*") if f.is_dir()]
    pictures = {f: int(f.name.removeprefix("episode-")) for f in root.glob("images/*/episode-*")}
    going = [*(films if left_out else []), *(f for f, episode in pictures.items() if episode in left_out)]
    for folder in going:
        name = folder.name if folder in films else f"{folder.parent.name}-{folder.name}"
        shutil.move(folder, _free(root / LEFT_OUT / name))
    deleted = [f for f in (*films, *pictures) if f not in going]
    for folder in deleted:
        shutil.rmtree(folder)
    if deleted:
        remarks.append("Pictures of the unfinished episode are deleted; its numbers were in memory.")


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
        stats = [{k[6:]: v for k, v in row.items() if k.startswith("stats/")} for row in known]
        write_stats(aggregate_stats([cast_stats_to_numpy(s) for s in stats]), work)
    return LeRobotDatasetMetadata("local/repaired", root=work)


def _tasks(root: Path, known: list[dict], remarks: list[str]) -> pd.DataFrame:
    file = root / "meta" / "tasks.parquet"
    if is_whole(file):
        return pd.read_parquet(file)
    names = list(dict.fromkeys(task for row in known for task in row["tasks"]))
    if file.exists():
        remarks.append("tasks.parquet was torn; a task that no complete episode names is called `task N`.")
    return pd.DataFrame({"task_index": range(len(names))}, index=pd.Index(names, name="task", dtype=object))


def describe(meta: LeRobotDatasetMetadata, root: Path, info: DatasetInfo, rows: Rows, video: dict) -> None:
    """Describes one episode again, with its statistics, as LeRobot does when it is saved."""
    table = rows.table()
    numbers = np.unique(table["task_index"])
    names = [] if meta.tasks is None else list(meta.tasks.index)
    names += [f"task {i}" for i in range(len(names), int(numbers.max()) + 1)]
    meta.save_episode_tasks(names)
    chunk, file = map(int, FILE_NUMBERS.search(rows.file.as_posix()).groups())
    begin = meta.total_frames
    place = {"data/chunk_index": chunk, "data/file_index": file}
    place |= {"dataset_from_index": begin, "dataset_to_index": begin + rows.length}
    with tempfile.TemporaryDirectory() as folder:
        values = {}
        for key, feature in info.features.items():
            if feature["dtype"] == "image":
                values[key] = []
                for i, cell in enumerate(table[key].to_pylist()):
                    values[key].append(f"{folder}/{len(values)}-{i}.png")
                    Path(values[key][-1]).write_bytes(cell["bytes"])
            elif feature["dtype"] == "video":
                path = video_file(root, info, key, video[key])
                first = round(video[key][2] * info.fps)
                values[key] = _write_frames(path, first, rows.length, Path(folder) / str(len(values)))
            elif feature["dtype"] != "string":
                values[key] = np.array(table[key].to_pylist(), dtype=feature["dtype"])
        stats = compute_episode_stats(values, info.features)
    for key, at in video.items():
        place |= {f"videos/{key}/{n}": v for n, v in zip(PLACE, at, strict=True)}
    meta.save_episode(rows.episode, rows.length, [names[i] for i in numbers], stats, place)


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


def place_videos(
    root: Path, info: DatasetInfo, known: list[dict], found: list[Rows], remarks: list[str]
) -> tuple[dict[str, list[Place]], dict[int, str]]:
    """Camera to the places of the episodes in its videos, all opened; episode to why a video is missing."""
    places: dict[str, list[Place]] = {}
    lacking: dict[int, str] = {}
    for key in (k for k, f in info.features.items() if f["dtype"] == "video"):
        film = _Films(root, info, key)
        places[key] = [tuple(row.get(f"videos/{key}/{n}") for n in PLACE) for row in known]
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

    def place(self, known: list[dict], new: list[Rows], remarks: list[str]) -> list[Place]:
        """Where episodes that are not known lie: one after another in the files after the last known one.

        How many episodes a missing or torn file held is not known, so that none is looked for after it.
        """
        numbers, out, at, begun = (0, 0), [], 0, False
        if known:
            last = (known[-1][f"videos/{self.key}/{n}"] for n in PLACE[:2])
            numbers = update_chunk_file_indices(*last, self.info.chunks_size)
        for rows in new:
            if begun:
                following = update_chunk_file_indices(*numbers, self.info.chunks_size)
                if self._ended(numbers, at, rows.length) and self._file(following).is_file():
                    numbers, at, begun = following, 0, False
            if not begun:
                _take_whole_one(self._file(numbers), rows.length, remarks)
                begun = True
            out.append((*numbers, at / self.info.fps, (at + rows.length) / self.info.fps))
            at += rows.length
        return out

    def look(self, rows: Rows, place: Place) -> None:
        """Raises InputError where the frames of an episode are not all in its video, or are damaged."""
        chunk, number, begin, _ = place
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

    def _file(self, place: Place) -> Path:
        return video_file(self.root, self.info, self.key, place)


def describe_videos(root: Path, info: DatasetInfo, videos: dict[str, list[Place]]) -> None:
    """Codec and size in `info.json`, which LeRobot writes after a dataset's first video."""
    for key, places in videos.items():
        known = info.features[key].get("info") or {}
        if places and "video.fps" not in known:
            info.features[key]["info"] = known | get_video_info(video_file(root, info, key, places[0]))


def video_file(root: Path, info: DatasetInfo, key: str, place: Place) -> Path:
    """The video of a place as `place_videos` gives it."""
    return root / info.video_path.format(video_key=key, chunk_index=place[0], file_index=place[1])


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
