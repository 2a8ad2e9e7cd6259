"""`pneutac convert`: makes a bench recording of what a lab's other systems logged."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lerobot_pneutac.measuring.camera import Intrinsics, MarkerTracker
from lerobot_pneutac.measuring.video import track_aruco, track_dots
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources import mocap, rosbag, tables
from pneutac_datasets.recording.sources.frame import BaseFrame, of_body, of_motion
from pneutac_datasets.recording.sources.joining import COMMAND, command, joined, shifted, tabled
from pneutac_datasets.recording.sources.tracks import Source, Track
from pneutac_sim.errors import InputError

FILMS = (".mp4", ".avi", ".mov", ".mkv")
KNOWN = (COMMAND, "pressure_kpa", "trial", "program", "temperature_c", "payload_g")


@dataclass
class ConvertConfig:
    """Options of `pneutac convert`.

    Attributes:
        source: a CSV of OptiTrack (Motive) or Vicon (Nexus), a .mat, the folder of a ROS 2 bag, or a film.
        out: folder of the new bench recording, which must not exist.
        length_mm: of the straight finger, base to tip marker.
        log: CSV or .mat of the pressures, where the source has none.
        columns: name in the log (or source) to column of the recording; left out, those that already go by
            the recording's names.
        time: name of the times in a CSV log or a .mat, s.
        offset_s: what the markers' clock shows when the log's shows zero.
        tip: name of the tip's marker or topic; in a film ArUco's number or a dot, see below.
        base: the same of a marker or body fixed at the finger's base.
        base_x: axis of the base's body along the straight finger; a single marker has none and x goes to
            where the tip rests, z the way that it bends.
        base_z: axis of the base's body in the bending direction.
        base_offset_mm: from the base marker's or body's origin to the finger's base, in the base frame; of
            ArUco markers the other way, as for `pneutac measure`.
        marker_mm: side of the ArUco markers in a film.
        intrinsics: the camera's calibration of a film, from `pneutac measure --chessboard`.
        tip_rgb: colour of the tip's dot in a film without ArUco markers.
        base_rgb: colour of the two dots at the base.
        dots_mm: distance of these two.
        date: of the measurement, such as 2026-03-01, for `compare` over several dates.
    """

    source: Path
    out: Path
    length_mm: float
    log: Path | None = None
    columns: dict[str, str] = field(default_factory=dict)
    time: str = tables.TIME
    offset_s: float = 0.0
    tip: str = ""
    base: str = ""
    base_x: str = "x"
    base_z: str = "z"
    base_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    marker_mm: float | None = None
    intrinsics: Path | None = None
    tip_rgb: tuple[int, int, int] | None = None
    base_rgb: tuple[int, int, int] | None = None
    dots_mm: float | None = None
    date: str = ""

    def __post_init__(self):
        for name in ("source", "log"):
            path = getattr(self, name)
            if path is not None and not Path(path).exists():
                raise InputError(f"{name} is '{path}', which does not exist.")
        if Path(self.out).exists():
            raise InputError(f"out is '{self.out}', which exists; give a new folder.")
        if not 1 <= self.length_mm <= 1000:
            raise InputError(f"length_mm is {self.length_mm:g}; give 1 to 1000 mm.")


def convert(config: ConvertConfig) -> Recording:
    """Writes the recording and reads it back with all the checks of one.

    Raises:
        InputError: one sentence: what is missing in which file, or a fault of the recording.
    """
    film = config.source.suffix.lower() in FILMS
    source = Source(config.source) if film else _read(config.source, config.time)
    log = source if config.log is None else _read(config.log, config.time)
    log = shifted(log, config.offset_s)
    columns = config.columns or {n: n for n in log.columns if n in KNOWN or n.startswith(("tip_", "bend_"))}
    if film:
        tip = _of_film(config)
        frame = BaseFrame(_upright(tip, command(tip, log, columns)), np.zeros(3))
    elif config.tip:
        tip = source.track(config.tip, "tip")
        frame = _frame(source.track(config.base, "base"), tip, config, command(tip, log, columns))
    elif any(c.startswith(("tip_", "bend_", "q_")) for c in columns.values()):
        tip = frame = None
    else:
        raise InputError(
            f"{config.source} has the markers {', '.join(source.tracks) or 'none'} and the columns"
            f" {', '.join(source.columns) or 'none'}; give --tip and --base, or --columns with the tip's."
        )
    if tip is None:
        recording = tabled(log, columns, {"length_mm": config.length_mm})
    else:
        recording = joined(tip, frame, log, columns, config.length_mm)
    if config.date:
        recording.meta["date"] = config.date
    recording.meta["notes"] = f"from {config.source.name}"
    try:
        return Recording.load(recording.write(config.out))
    except InputError:
        shutil.rmtree(config.out)  # there was no such folder before
        raise


def _read(path: Path, time: str) -> Source:
    if path.is_dir() or path.suffix.lower() in (".mcap", ".db3"):
        return rosbag.read_rosbag(path)
    if path.suffix.lower() == ".mat":
        return tables.read_mat(path, time)
    if path.suffix.lower() != ".csv":
        raise InputError(f"'{path}' is none of .csv, .mat, {', '.join(FILMS)} or the folder of a ROS 2 bag.")
    if mocap.is_optitrack(path):
        return mocap.read_optitrack(path)
    return mocap.read_vicon(path) if mocap.is_vicon(path) else tables.read_log(path, time)


def _frame(base: Track, tip: Track, config: ConvertConfig, kpa: np.ndarray) -> BaseFrame:
    """The base frame, by a body's axes or, of a single marker, by how the tip moves."""
    if base.rotation is not None:
        return of_body(base, config.base_x, config.base_z, np.array(config.base_offset_mm))
    seen = np.isfinite(base.position_mm).all(1)
    if not seen.any():
        raise InputError("The base's marker is never seen; choose another --base.")
    frame = of_motion(np.median(base.position_mm[seen], 0), tip.position_mm, kpa)
    return BaseFrame(frame.rotation, frame.origin_mm + frame.rotation @ np.array(config.base_offset_mm))


def _of_film(config: ConvertConfig) -> Track:
    camera = None if config.intrinsics is None else Intrinsics.load(config.intrinsics)
    if config.marker_mm is not None:
        if camera is None:
            raise InputError("A film with ArUco markers needs --intrinsics, the camera's calibration.")
        ids = [int(n) if n.isdigit() else k for k, n in enumerate((config.base, config.tip))]
        return track_aruco(
            config.source, MarkerTracker(camera, config.marker_mm, *ids, np.array(config.base_offset_mm))
        )
    if config.tip_rgb is None or config.base_rgb is None or config.dots_mm is None:
        raise InputError(
            "A film needs --marker_mm (ArUco markers 0 at the base and 1 at the tip, with --intrinsics), or"
            " --tip_rgb, --base_rgb and --dots_mm (coloured dots)."
        )
    return track_dots(config.source, config.tip_rgb, config.base_rgb, config.dots_mm, camera)


def _upright(tip: Track, kpa: np.ndarray) -> np.ndarray:
    """Turns by half a turn about x where positive pressure bends the film's finger towards -z."""
    z = tip.position_mm[:, 2]
    seen = np.isfinite(z)
    bends = np.sum((z[seen] - np.median(z[seen])) * (kpa[seen] - kpa[seen].mean()))
    return np.diag([1.0, 1.0, 1.0] if bends >= 0 else [1.0, -1.0, -1.0])
