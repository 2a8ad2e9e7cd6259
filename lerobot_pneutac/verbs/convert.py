"""`pneutac convert`: makes a bench recording of what a lab's other systems logged."""

import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import ClassVar

import numpy as np

from lerobot_pneutac.cli.tables import confirm, show_understood
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.measuring import Intrinsics, MarkerTracker, track_aruco, track_dots
from pneutac_datasets.recording import rules
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources import plain, readers
from pneutac_datasets.recording.sources.columns import Column, parse_columns
from pneutac_datasets.recording.sources.plain import Given, Understood
from pneutac_datasets.recording.sources.readers import BaseFrame, Source, Track, read_rosbag
from pneutac_datasets.recording.wording import listed
from pneutac_sim.errors import InputError, check_length, refuse_given

# Options that only some sources have a use for; see `_refuse_ignored`.
FILM = ("marker_mm", "intrinsics", "tip_rgb", "base_rgb", "dots_mm")
MARKERS = ("log", "offset_s", "base_offset_mm")
ARUCO, DOTS = ("tip", "base", "base_offset_mm", "marker_mm"), ("tip_rgb", "base_rgb", "dots_mm")
BASE, LOG = ("base", "base_x", "base_z", "base_offset_mm"), ("time", "rate_hz")
FILMS = (".mp4", ".avi", ".mov", ".mkv")


@dataclass
class ConvertConfig:
    """Options of `pneutac convert`."""

    first: ClassVar = "source"

    # a table (CSV, text, Parquet, .mat, .npz), several of them (`a.csv,b.csv`, `'runs/*.csv'`) as one run
    # each, a CSV of OptiTrack (Motive) or Vicon (Nexus), the folder of a ROS 2 bag, or a film.
    # `pneutac convert FILE` is the same as `--source=FILE`
    source: Path
    # folder of the new bench recording, new or empty; that of tables is `NAME.recording` next to them
    # if omitted
    out: Path | None = None
    replace: bool = False  # replaces an earlier conversion of tables, made with other options
    # of the straight finger, base to tip marker; of a table left out, where the tip rests
    length_mm: float | None = None
    log: Path | None = None  # table of the pressures, where markers or a film have none
    # what columns of a table or log are, where their names do not say it: `p: pressure_cmd_kpa [bar], u:
    # pressure_kpa * 20 - 10, note: -`; `-` leaves one out
    columns: str = ""
    yes: bool = False  # take the units of the pose that are guessed by size, without asking
    mapping: Path | None = None  # `mapping.yaml` of an earlier conversion, which is repeated
    time: str = ""  # name of the times in a table, .mat or .npz, where it does not say so
    rate_hz: float | None = None  # rows or frames a second of a table without times
    offset_s: float = 0.0  # what the markers' clock shows when the log's shows zero
    tip: str = ""  # name of the tip's marker or topic; in a film ArUco's number or a dot, see below
    # the same of a marker or body fixed at the finger's base; of a table the base's position in its frame,
    # mm, such as 10,20,5
    base: str = ""
    # axis of the base's body, or of the table's frame, along the straight finger, such as `z` or `-y`; a
    # single marker has none and x goes to where the tip rests, z the way that it bends
    base_x: str = "x"
    base_z: str = "z"  # the same axis in the bending direction
    # from the base marker's or body's origin to the finger's base, in the base frame; of ArUco markers the
    # other way, as for `pneutac measure`
    base_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    marker_mm: float | None = None  # side of the ArUco markers in a film
    intrinsics: Path | None = None  # the camera's calibration of a film, from `pneutac measure --chessboard`
    tip_rgb: tuple[int, int, int] | None = None  # colour of the tip's dot in a film without ArUco markers
    base_rgb: tuple[int, int, int] | None = None  # colour of the two dots at the base
    dots_mm: float | None = None  # distance of these two
    date: str = ""  # of the measurement, such as 2026-03-01, for `compare` over several dates

    def __post_init__(self):
        self.columns = parse_columns(self.columns)
        if self.log is not None and not Path(self.log).exists():
            raise InputError(f"log is '{self.log}', which does not exist.")
        if not Path(self.source).exists() and not plain.table_files(self.source):
            raise InputError(f"source is '{self.source}', which does not exist.")
        path = Path(self.source)
        if path.is_dir() and not any(path.glob("*.mcap")) and not any(path.glob("*.db3")):
            raise InputError(f"source is '{path}', a folder that is no ROS 2 bag; give a table or a take.")
        out = None if self.out is None else Path(self.out)
        if out is not None and out.exists() and not (plain.is_unfinished(out) or plain.is_ours(out)):
            raise InputError(f"out is '{out}', which exists; give a new folder.")
        if self.date:
            try:
                date.fromisoformat(self.date)
            except ValueError:
                raise InputError(f"date is '{self.date}', no day; write it as 2026-03-01.") from None
        if self.length_mm is not None:
            check_length(self.length_mm)
        if self.rate_hz is not None and not 0 < self.rate_hz < 1e6:
            raise InputError(f"rate_hz is {self.rate_hz:g}; give the rows a second.")


def _refuse_ignored(config: ConvertConfig, film: bool, tables: bool) -> None:
    """Raises InputError where an option is given that such a source has no use for."""
    if tables:
        return refuse_given(config, (*FILM, *MARKERS), "is of markers or a film, and the source is a table")
    refuse_given(config, ("mapping",), "is of a table, and the source is none")
    if config.log is None:
        refuse_given(config, LOG, "is of a table, and neither source nor --log is one")
    if not film:
        refuse_given(config, FILM, "is of a film, and the source is none")
        if not config.tip:
            refuse_given(config, BASE, "is of markers, and --tip names none")
        return
    refuse_given(config, ("base_x", "base_z"), "is of a body with axes, and a film has none")
    aruco = config.marker_mm is not None
    other = "ArUco markers (--marker_mm)" if aruco else "coloured dots"
    refuse_given(config, DOTS if aruco else ARUCO, f"has no use beside {other}")


def convert(config: ConvertConfig, show: Callable[[Understood], None] = lambda understood: None) -> Recording:
    """Writes the recording and reads it back with all the checks of one; InputError says what is missing."""
    film = config.source.suffix.lower() in FILMS
    read = None if film else _reader(config.source)
    _refuse_ignored(config, film, not (film or read))
    if not (film or config.tip or read):
        return _convert_tables(config, show)
    refuse_given(config, ("replace",), "is of a conversion of tables, and the source is none")
    missing = [n for n in ("out", "length_mm") if getattr(config, n) is None]
    if missing:
        raise InputError(f"{missing[0]} is missing; markers and films need it.")
    if plain.is_ours(config.out) and not plain.is_unfinished(config.out):
        raise InputError(f"out is '{config.out}', which exists; give a new folder.")
    if not (film or read):
        raise InputError(f"{config.source} has no markers; leave out --tip, and name columns by --columns.")
    source = read(config.source) if read else Source(config.source)
    log = source
    if config.log is not None:
        given = Given(_columns(config), rate_hz=config.rate_hz)
        table = Understood([config.log], given, log=True, time=config.time).recording.samples
        times = table["time_s"].to_numpy(float)
        names = [c for c in table if c not in ("time_s", "trial", "run")]
        log = Source(config.log, {}, {c: (times, table[c].to_numpy()) for c in names})
    log = readers.shifted(log, config.offset_s)
    columns = {n: n for n in log.columns} if config.log is not None else config.columns
    if film:
        camera = None if config.intrinsics is None else Intrinsics.load(config.intrinsics)
        if config.marker_mm is not None:
            if camera is None:
                raise InputError("A film with ArUco markers needs --intrinsics, the camera's calibration.")
            ids = [int(n) if n.isdigit() else k for k, n in enumerate((config.base, config.tip))]
            offset = np.array(config.base_offset_mm)
            tip = track_aruco(config.source, MarkerTracker(camera, config.marker_mm, *ids, offset))
        elif None in (config.tip_rgb, config.base_rgb, config.dots_mm):
            aruco = "--marker_mm (ArUco markers 0 at the base and 1 at the tip, with --intrinsics)"
            raise InputError(f"A film needs {aruco}, or --tip_rgb, --base_rgb and --dots_mm (coloured dots).")
        else:
            tip = track_dots(config.source, config.tip_rgb, config.base_rgb, config.dots_mm, camera)
        z, kpa = tip.position_mm[:, 2], readers.commanded(tip, log, columns)
        seen = np.isfinite(z)
        up = np.sum((z[seen] - np.median(z[seen])) * (kpa[seen] - kpa[seen].mean())) >= 0
        # by half a turn about x where positive pressure bends the film's finger towards -z
        frame = BaseFrame(np.diag([1.0, 1.0, 1.0] if up else [1.0, -1.0, -1.0]), np.zeros(3))
    elif config.tip:
        tip = source.track(config.tip, "tip")
        frame = _frame(source.track(config.base, "base"), tip, config, readers.commanded(tip, log, columns))
    elif any(re.match("tip_|bend_|q_", c) for c in config.columns.values()):  # a bag of numbers alone
        names = {n: Column.parsed(n, c).column for n, c in config.columns.items()}
        tip, recording = None, log.recording(names, {"length_mm": config.length_mm})
    else:
        markers, found = (listed(x) or "none" for x in (source.tracks, source.columns))
        has = f"{config.source} has the markers {markers} and the columns {found}"
        raise InputError(f"{has}; give --tip and --base, or --columns with the tip's.")
    if tip is not None:
        recording = readers.joined(tip, frame, log, columns, config.length_mm)
    recording.meta |= {"date": config.date} if config.date else {}
    recording.meta["notes"] = f"from {config.source.name}"
    rules.check_samples(recording.samples, recording.device, recording.meta, config.source)
    return replace(Recording.load(recording.write(config.out)), warnings=recording.warnings)


def _convert_tables(config: ConvertConfig, show: Callable[[Understood], None]) -> Recording:
    files = plain.table_files(config.source)
    if not files:
        raise InputError(f"source is '{config.source}', a folder of no ROS 2 bag; give a table or a take.")
    folder = config.out or plain.folder_of(files)
    if config.out is None and folder.exists() and not plain.is_ours(folder):
        raise InputError(f"out is '{folder}', which exists; give a new folder.")
    columns = _columns(config)
    base = (0.0, 0.0, 0.0)
    if config.base:
        try:
            base = tuple(float(v) for v in config.base.strip("[]() ").split(","))
        except ValueError:
            base = ()
        if len(base) != 3:
            raise InputError(f"base is '{config.base}'; of a table give three mm, such as 10,20,5.")
    given = Given.load(config.mapping) if config.mapping is not None else Given()
    names = ("base_x", "base_z", "length_mm", "rate_hz", "date")
    options = {"base_mm": base} | {name: getattr(config, name) for name in names}
    options = {n: v for n, v in options.items() if v != Given.__dataclass_fields__[n].default}
    given = replace(given, columns=given.columns | columns, **options)
    understood = Understood(files, given, time=config.time)
    show(understood)
    return understood.write(folder, config.replace)


def _columns(config: ConvertConfig) -> dict[str, str]:
    return ({config.time: "time_s"} if config.time else {}) | config.columns


def _reader(path: Path) -> Callable[[Path], Source] | None:
    """What reads the markers of a take or a bag; None for anything else."""
    if path.is_dir() or path.suffix.lower() in (".mcap", ".db3"):
        return read_rosbag
    if path.suffix.lower() != ".csv" or not path.is_file():
        return None
    if readers.is_optitrack(path):
        return readers.read_optitrack
    return readers.read_vicon if readers.is_vicon(path) else None


def _frame(base: Track, tip: Track, config: ConvertConfig, kpa: np.ndarray) -> BaseFrame:
    """The base frame, by a body's axes or, of a single marker, by how the tip moves."""
    if base.rotation is not None:
        return readers.of_body(base, config.base_x, config.base_z, np.array(config.base_offset_mm))
    refuse_given(config, ("base_x", "base_z"), "is of a body with axes, and --base is a single marker")
    seen = np.isfinite(base.position_mm).all(1)
    if not seen.any():
        raise InputError("The base's marker is never seen; choose another --base.")
    frame = readers.of_motion(np.median(base.position_mm[seen], 0), tip.position_mm, kpa)
    return BaseFrame(frame.rotation, frame.origin_mm + frame.rotation @ np.array(config.base_offset_mm))


def command(config: ConvertConfig, terminal: Terminal) -> None:
    tables: list[Understood] = []

    def show(understood: Understood) -> None:
        tables.append(understood)
        show_understood(understood, terminal.console)
        if understood.guessed and not (config.yes or understood.faults):
            confirm(config.source)

    recording = convert(config, show)
    if not tables:
        terminal.say(f"{config.source}: {plain.extent(recording)}")
    shown = [note for understood in tables for note in understood.notes]
    for warning in (w for w in recording.warnings if w not in shown):
        terminal.note(warning)
    terminal.say(f"{recording.folder} holds the recording.")
    new = ["pneutac", "new", "--twin=TWIN", f"--recording={recording.folder}"]
    terminal.next_step(shlex.join([*new, *["--length_mm=LENGTH"] * (recording.length_mm is None)]))
