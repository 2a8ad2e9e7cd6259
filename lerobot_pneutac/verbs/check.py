"""What a later verb would refuse in a dataset, a recording or a twin: all at once, in seconds."""

import difflib
import sys
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shlex import quote

from rich.markup import escape

from lerobot_pneutac.cli.tables import show_understood
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.pair import enough_to_compare, fit_parts
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_datasets.demonstrations.reading import is_demonstrations
from pneutac_datasets.recording.checks import check, recording_faults
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources import plain
from pneutac_datasets.recording.sources.plain import Understood, refuse_other_axes
from pneutac_datasets.recording.wording import grouped, plural
from pneutac_sim.effects.registry import get_effect, of_body, of_sensor
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.finger.online import COMPUTED
from pneutac_sim.gel.model import GelModel
from pneutac_sim.pace import info_file
from pneutac_sim.twin import PAPER_FINGER, Twin, Value, lost_twin
from pneutac_sim.world.checks import check_networks, check_world, out_of_reach
from pneutac_sim.world.station import Station, station_faults, station_of

SHORT = 1000  # rows: a diagnosis refuses none that is longer
WORLD = ("joint_stiffness_nm_per_rad", "joint_damping_nms_per_rad", "gain_rad_per_kpa")
MARKS = "twin.yaml", "recording.json", "meta/info.json"  # what is in a folder that can be looked at


@dataclass(frozen=True)
class Checked:
    """What was found."""

    path: Path
    kind: str  # `twin`, `bench recording`, `table`, `demonstrations` or `station`
    faults: list[str]  # one sentence for each thing that a later verb refuses
    notes: list[str]  # one for each thing that is poor but usable
    understood: Understood | None = None  # of a table, what its columns were taken for


def check_path(path: str | Path, twin: Twin | None = None, station: Station | None = None) -> Checked:
    """Looks at a folder of any kind, at tables or at a `station.yaml`; InputError where there is none.

    Demonstrations are augmented on `twin`, default the built-in one, and were recorded in `station`, default
    the one left in their `meta`, or the paper's.
    """
    path = Path(path)
    if path.suffix in (".yaml", ".yml") and path.is_file():
        return Checked(path, "station", *_station(path, twin or Twin.builtin()))
    if files := plain.table_files(path):
        return _tables(path, files)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} cannot be checked; give a folder, a table or a station.yaml.")
    if not path.is_dir():
        there = [p.name for p in path.absolute().parent.glob("*") if p.name != path.name]  # a link to nowhere
        near = difflib.get_close_matches(path.name, there, n=1)
        raise InputError(f"There is no folder '{path}'" + (f"; is '{near[0]}' meant?" if near else "."))
    if (path / "twin.yaml").is_file():
        return Checked(path, "twin", *_twin(path))
    if not (path / "recording.json").is_file() and is_demonstrations(path):
        station = station or station_of(path) or Station()
        recorded = Recorded(path)
        faults = recorded.faults(twin or Twin.builtin(), station)
        notes = recorded.rate_notes() if faults else recorded.notes(station) + recorded.set_aside()
        return Checked(path, "demonstrations", faults, notes)
    if not any((path / mark).is_file() for mark in MARKS) and (lost := lost_twin(path)):
        return Checked(path, "twin", [lost], [])
    if (path / "meta").is_dir():
        info_file(path)
    inside = [d.name for d in sorted(path.iterdir()) if any((d / mark).is_file() for mark in MARKS)]
    if inside and not (path / "recording.json").is_file():
        raise InputError(f"'{path}' is a folder of folders; give one of them: {', '.join(inside)}.")
    return _bench(path)


def _bench(folder: Path) -> Checked:
    faults, notes = recording_faults(folder)
    return Checked(folder, "bench recording", faults or _unfit(Recording.load(folder)), notes)


def _unfit(recording: Recording) -> list[str]:
    """What verbs refuse of a recording that can be read, by a twin of its own."""
    poses = recording.poses
    if recording.device == "gel" or not poses:
        return []  # gels and photographs have checks of their own
    twin = new_twin(recording.device, recording)

    def study() -> None:
        fit_parts(twin, recording)
        if len(recording) < SHORT:
            study_of(twin, recording)

    looks = (refuse_other_axes, recording), (enough_to_compare, recording, check(recording)[0])
    return _refused((study,), *looks)


def _refused(*calls: tuple) -> list[str]:
    """What calls, each a function and its arguments, refuse: sentences, each once."""
    found: dict[str, None] = {}
    for call, *args in calls:
        try:
            call(*args)
        except InputError as e:
            found[str(e)] = None
    return list(found)


def _tables(path: Path, files: list[Path]) -> Checked:
    folder = plain.folder_of(files)
    if plain.is_current(folder, files):
        return _bench(folder)
    try:
        known = plain.Given.load(folder / plain.MAPPING) if plain.is_ours(folder) else plain.Given()
        understood = plain.Understood(files, known)
    except InputError as e:
        return Checked(path, "table", [str(e)], [])
    recording = understood.recording.as_written()  # what `calibrate` reads
    notes = [] if understood.faults else check(recording)[1]
    faults = understood.faults or _unfit(replace(recording, folder=path))
    return Checked(path, "table", faults, notes, understood)


def _station(path: Path, twin: Twin) -> tuple[list[str], list[str]]:
    faults = station_faults(path)
    if faults:
        return faults, []
    short = out_of_reach(Station.load(path), twin.length_mm)
    try:
        check_world(twin, "probe", {})
    except InputError as e:
        faults = [f"A robot with this twin is refused: {e}"]
    return faults, [
        f"The arm falls {missing:.2g} m short of where the task '{task}' starts; choose another base_m."
        for task, missing in short.items()
    ]


def _twin(path: Path) -> tuple[list[str], list[str]]:
    faults, notes = Twin.faults(path), []
    if faults:
        return faults, notes
    twin = Twin.load(path)
    file = f"{path / 'twin.yaml'}: "
    faults += [file + fault.removeprefix(file) for fault in _broken(twin)]
    if faults:
        return faults, notes
    for name in of_body(twin.effects):
        needed = [c for c in get_effect(name).columns if c not in COMPUTED]
        if needed:
            need = f"With the effect {name} robots and environments need {', '.join(needed)}"
            notes.append(f"{need}: give them as --env.conditions='{{{needed[0]}: ...}}'.")
    if twin.device == "finger":
        missing = [n for n in WORLD if n not in twin.parameters]
        if missing:
            notes.append(f"The world needs {', '.join(missing)}, which `pneutac new` and `calibrate` write.")
        elif find_spec("taichi") or find_spec("quadrants"):  # else no world is simulated here
            try:
                check_networks(twin, "surrogate")
            except InputError as e:
                without = "" if "`probe`" in str(e) else " Until then --env.fidelity=probe works without."
                notes.append(f"{e}{without}")
    stiffness = twin.parameters.get(WORLD[0])
    if twin.device == "arm" and stiffness == Value(PAPER_FINGER[WORLD[0]]):
        assumed = f"{WORLD[0]} is {stiffness.value:g}, assumed and not measured"
        use = "it is how far a touch bends the body in the world"
        notes.append(f"{assumed}: {use}; measure it by a weight across the tip.")
    return faults, notes


def _broken(twin: Twin) -> list[str]:
    """One sentence for each effect that no pipeline and no sensor takes, and for a gel that is malformed."""
    calls = []
    for name, values in twin.effects.items():
        numbers = {name: {k: v.value for k, v in values.items()}}
        body = (_body, replace(twin, effects={name: values}))
        calls.append((partial(replace, GelModel.builtin(), effects=numbers),) if of_sensor([name]) else body)
    alone = _refused(*calls, (GelModel.from_twin, replace(twin, effects={})))
    return alone or _refused((_body, twin), (GelModel.from_twin, twin))


def _body(twin: Twin) -> None:
    for name in twin.effects:
        get_effect(name)
    if twin.device != "gel":
        Pipeline.of(twin).theta(twin)


USAGE = """usage: pneutac check PATH [PATH ...] [--twin=PATH] [--station=FILE]

Lists in seconds what a later command would refuse, and exits with 1 if there is anything.

  PATH            folder of a twin, a bench recording or a LeRobotDataset of demonstrations, a lab's table
                  (CSV, .mat, .npz, Parquet) or a station.yaml
  --twin=PATH     twin for which demonstrations or a station are looked at (default the built-in one)
  --station=FILE  station.yaml in which demonstrations were recorded (default the one stored with them)"""


def command(argv: list[str], terminal: Terminal) -> None:
    if not argv or {"-h", "--help"} & set(argv):
        print(USAGE)
        return
    options = dict(a.split("=", 1) for a in argv if a.startswith("--") and "=" in a)
    wrong = [a for a in argv if a.startswith("-") and a.split("=")[0] not in ("--twin", "--station")]
    wrong += [a for a in ("--twin", "--station") if a in argv]
    if wrong:
        name, _, path = wrong[0].partition("=")
        how = ""
        if path and name in ("--recording", "--dataset.root"):  # as of the other verbs
            how = f" A path stands alone: `pneutac check {quote(path)}`."
        raise InputError(
            f"There is no option {wrong[0]}; the options are --twin=PATH and --station=FILE.{how}"
        )
    twin = Twin.load(options["--twin"]) if "--twin" in options else None
    station = Station.load(options["--station"]) if "--station" in options else None
    faulty, checked = False, [check_path(a, twin, station) for a in argv if not a.startswith("-")]
    for name, kinds in (("--twin", ("station", "demonstrations")), ("--station", ("demonstrations",))):
        if name in options and not any(found.kind in kinds for found in checked):
            raise InputError(f"{name} is of {' or '.join(kinds)}, and none is given; leave it out.")
    for found in checked:
        faulty = faulty or bool(found.faults)
        if found.understood is not None:
            show_understood(found.understood, terminal.console)
        faults, notes = grouped(found.faults), grouped(found.notes)
        verdict = f"[red]{plural(len(faults), 'problem')}[/]" if faults else "[green]good[/]"
        terminal.say(f"{escape(str(found.path))} ({found.kind}): {verdict}", markup=True)
        for mark, sentences in (("[red]problem:[/]", faults), ("[yellow]note:[/]", notes)):
            for sentence in sentences:
                terminal.say(f"  {mark} {escape(sentence)}", markup=True)
    if faulty:
        sys.exit(1)
