"""ROS 2 bags by the library rosbags, which needs no ROS."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from pneutac_datasets.recording.sources.tracks import Source, Track, rotations
from pneutac_sim.errors import InputError

MM_A_M = 1000.0  # ROS counts in metres


def read_rosbag(folder: Path) -> Source:
    """Poses and numbers of every topic of a bag, on the times of its messages' headers.

    A message with a position, also inside `pose`, `pose.pose`, `transform` or `point`, is a marker by its
    topic's name. Every number of any message is a column `topic.field`, such as `/valve/command.data`; times
    begin with the bag's first message. Messages without a header have the time at which they were logged.

    Args:
        folder: the bag's, with its metadata.yaml (or the file of an .mcap).

    Raises:
        InputError: rosbags is not installed, or the bag cannot be read.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as e:
        raise InputError("A ROS 2 bag needs rosbags: uv pip install -e '.[ros]' in PneuTac's folder.") from e
    times: dict[str, list[float]] = {}
    numbers: dict[str, dict[str, list[float]]] = {}
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, logged_ns, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                found: dict[str, float] = {}
                _flatten("", message, found)
                stamp = _stamp(message)
                times.setdefault(connection.topic, []).append(logged_ns * 1e-9 if stamp is None else stamp)
                into = numbers.setdefault(connection.topic, {k: [] for k in found})
                for name in into:
                    into[name].append(found.get(name, np.nan))
    except (AnyReaderError, OSError, ValueError, KeyError) as e:
        raise InputError(f"{folder} is no ROS 2 bag that rosbags reads ({e}).") from e
    source, begin = Source(folder), min((t[0] for t in times.values()), default=0.0)
    for topic, fields in numbers.items():
        at = np.array(times[topic]) - begin
        order = np.argsort(at, kind="stable")
        columns = {name: np.array(values)[order] for name, values in fields.items()}
        source.columns |= {f"{topic}.{name}": (at[order], values) for name, values in columns.items()}
        track = _track(at[order], columns)
        if track is not None:
            source.tracks[topic] = track
    return source


def _track(time_s: np.ndarray, columns: dict[str, np.ndarray]) -> Track | None:
    for place, turn in (
        ("pose.position", "pose.orientation"),
        ("pose.pose.position", "pose.pose.orientation"),
        ("position", "orientation"),
        ("transform.translation", "transform.rotation"),
        ("point", ""),
    ):
        if all(f"{place}.{a}" in columns for a in "xyz"):
            position = np.stack([columns[f"{place}.{a}"] for a in "xyz"], 1) * MM_A_M
            turns = [columns[f"{turn}.{a}"] for a in "xyzw" if f"{turn}.{a}" in columns]
            R = rotations(np.stack(turns, 1)) if len(turns) == 4 else None
            return Track(time_s, position, R)
    return None


def _flatten(name: str, value: Any, into: dict[str, float]) -> None:
    """Numbers of a message by the path of their field; arrays of up to 16 entries by their index."""
    if isinstance(value, bool | int | float | np.integer | np.floating):
        into[name] = float(value)
    elif isinstance(value, np.ndarray | list | tuple) and len(value) <= 16:
        for i, entry in enumerate(value):
            _flatten(f"{name}.{i}", entry, into)
    elif dataclasses.is_dataclass(value):
        for entry in (f.name for f in dataclasses.fields(value) if not f.name.startswith("__")):
            _flatten(f"{name}.{entry}" if name else entry, getattr(value, entry), into)


def _stamp(message: Any) -> float | None:
    """Time of a message's header, s; None where it has none or it was never set."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = 0.0 if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
    return seconds if seconds > 0 else None
