"""`pneutac augment`: makes many demonstrations out of a few, carried out on the twin."""

import shlex
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.reports.page import SERIES, Report
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.demonstrations.augment.planner import PlannerConfig
from pneutac_datasets.demonstrations.augment.reference import Reference, onset_sigma_m
from pneutac_datasets.demonstrations.faults import TACTILE, Recorded
from pneutac_datasets.recording.wording import plural
from pneutac_sim.errors import InputError, check_between, check_choice, check_least, refuse_given
from pneutac_sim.executor import ExecutorOptions, check_device
from pneutac_sim.features import FIDELITIES, VELOCITY_NAMES, Places, task_names
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import MOST_WIDE
from pneutac_sim.world.checks import check_bends, check_world
from pneutac_sim.world.station import Station, station_file

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata

    from pneutac_sim.gel.sensor import TactileSensor

METHODS = ("library", "expert", "planner", "naive")
SCENE = ("twin", "fidelity", "conditions", "station", "planner", "attempts", "device")  # not of naive ones
MOST_START_M, MOST_REAL = 0.1, 0.9
MOST_ELSEWHERE = 0.05  # share of the pixels that differ from the twin's image at rest; more is noted
FEW_ATTEMPTS, FEW_WORKED = 20, 0.15  # with demonstrations of the same finger 17 % or more do the task
REAL_SHARE = 0.25  # of the frames, with which ten and a hundred new ones were trained best


@dataclass
class DatasetRef:
    """A LeRobotDataset."""

    repo_id: str  # name of the dataset
    root: Path  # folder of the dataset


@dataclass
class AugmentConfig(ExecutorOptions):
    """Options of `pneutac augment`."""

    dataset: DatasetRef  # recorded demonstrations
    output: DatasetRef  # new demonstrations, whose folder must not exist
    # the task in front of the robot, such as `switch`; if omitted, the one that the demonstrations'
    # instruction names
    task: str = ""
    # `library` (a controller made of the demonstrations, which starts near recorded starts and finds the
    # object by touch), `expert` (the scripted controller that the task brings), `planner` (each is planned,
    # guided by one demonstration's touch; `tactile` is its former name), or `naive` (varied without a
    # simulator; looks at dataset, output, episodes and seed alone)
    method: str = "library"
    episodes: int = 100  # number of new demonstrations
    seed: int = 0  # seed of every random choice
    twin: Path | None = None  # folder of the finger's twin; if omitted, the built-in one
    # way in which finger and gel deform where the plans are carried out: `surrogate`, by networks, `mpm`, by
    # material points, or `probe`, by formulas; plans are made with the same, those for material points with
    # formulas
    fidelity: str = "surrogate"
    # values that the twin's effects ask for, such as {temperature_c: 28}; every demonstration draws from a
    # range [low, high]
    conditions: dict[str, float | list[float]] = field(default_factory=dict)
    # file `station.yaml` of arm, workspace, mount and control rate in which they were recorded; if omitted,
    # the one that their robot left in them, or the paper's
    station: Path | None = None
    planner: PlannerConfig = field(default_factory=PlannerConfig)  # its horizon, samples and weights
    # half widths in m along x, y and z of the starts of `library` and `expert` around recorded starts; if
    # omitted, the standard deviation of the recorded starts, 0.004 at least
    start_range: tuple[float, float, float] | None = None
    # how much wider than the task's own the objects stand, 0 to 2, as --robot.start_width of the recording
    start_width: float = 0.0
    # share of the frames that are to be recorded ones; as many copies of the demonstrations are added, so
    # that `lerobot-train` mixes them. If omitted, 0.25 with `library` and `expert` and 0 with the others
    real_share: float | None = None
    attempts: int = 30  # number of variants tried for one demonstration before giving up
    # number of the new demonstrations that are carried out once more by material points; how far they agree
    # goes into the report. Each takes minutes
    check_mpm: int = 0
    device: str = "cpu"  # `cpu`, a world a process, or `cuda`, many worlds on a GPU, of `library` alone
    worlds: int = 1024  # that are stepped together on a GPU
    out: Path | None = None  # folder for `report.html` and `result.json`

    def __post_init__(self):
        if self.task:
            check_choice("task", self.task, task_names())
        self.method = "planner" if self.method == "tactile" else self.method
        check_choice("method", self.method, METHODS)
        anywhere = self.method in ("library", "expert")
        for name in ("start_range", "start_width"):
            if getattr(self, name) and not anywhere:
                raise InputError(f"{name} is of library and expert, not of {self.method}; leave it out.")
        if self.device == "cpu":
            refuse_given(self, ("worlds",), "is of --device=cuda")
        if not all(0 <= x <= MOST_START_M for x in self.start_range or ()):
            raise InputError(f"start_range must be three numbers of 0 to {MOST_START_M} m.")
        if not 0 <= self.start_width <= MOST_WIDE:
            raise InputError(f"start_width is {self.start_width:g}; it must be from 0 to {MOST_WIDE:g}.")
        if anywhere and self.planner != PlannerConfig():
            raise InputError(f"planner has options that {self.method} does not use; give method=planner.")
        if self.real_share is None:
            self.real_share = REAL_SHARE if anywhere else 0.0
        if not 0 <= self.real_share <= MOST_REAL or (self.real_share and self.method == "naive"):
            raise InputError(f"real_share must be 0 to {MOST_REAL:g}, and 0 with naive.")
        check_choice("fidelity", self.fidelity, FIDELITIES)
        self.check_executor()
        check_least(1, episodes=self.episodes, attempts=self.attempts, worlds=self.worlds)
        check_choice("device", self.device, ("cpu", "cuda"))
        if self.device != "cpu":
            self._check_device()
        check_between(0, self.episodes, check_mpm=self.check_mpm)
        if self.check_mpm and self.method == "naive":
            raise InputError("check_mpm carries demonstrations out; naive ones have no scene; leave it out.")
        if self.check_mpm and self.fidelity == "mpm":
            raise InputError("check_mpm compares with what fidelity=mpm is already; leave it out.")
        if self.method == "naive":
            refuse_given(self, SCENE, "is of a simulated scene, which method=naive does without")
        twin = Twin.load(self.twin) if self.twin else Twin.builtin()
        if self.method != "naive":
            check_world(twin, self.fidelity, self.conditions)
            if self.check_mpm:
                check_bends(twin, "mpm")
        if self.station is not None:
            Station.load(self.station).make_arm()

    def _check_device(self) -> None:
        for name, only in (("method", "library"), ("executor", "local")):
            if (value := getattr(self, name)) != only:
                raise InputError(f"device=cuda is of {name}={only}, not of {value}; leave one out.")
        check_device(self.device)
        import pneutac_sim.world.batch  # noqa: F401  refuses where MuJoCo Warp is not installed


@dataclass(frozen=True)
class Augmentation(Result):
    """What an augmentation came to."""

    heading = "Augmentation of {0.config.dataset.repo_id} ({0.config.method})"

    config: AugmentConfig
    summary: dict  # `kept`, `attempts`, `rejected` (reason to number), `wall_s`, and the provenance
    references: list  # the recorded demonstrations that were used
    failed: dict[int, str] = field(default_factory=dict)  # the others, number to why each was set aside
    set_aside: list[str] = field(default_factory=list)  # the same as a sentence, if there are any

    @property
    def share(self) -> float:
        """Of the variants that were tried, those that did the task."""
        return self.summary["kept"] / self.summary["attempts"]

    def rows(self) -> list[dict]:
        rejected = {f"rejected: {reason}": count for reason, count in self.summary["rejected"].items()}
        counts = {"accepted": self.summary["kept"]} | rejected | {"yield": f"{100 * self.share:.0f} %"}
        return [{"variants": name, "number": number} for name, number in counts.items()]

    def remarks(self) -> list[str]:
        stored, minutes = self.summary["kept"], self.summary["wall_s"] / 60
        checks, out = self.summary.get("checks", []), []
        if checks:
            agree = sum(c["success"] for c in checks)
            out.append(f"Material points do the task in {agree} of {len(checks)} of them too.")
        pace = f"{minutes:.1f} minutes, {stored / minutes:.0f} a minute"
        new = f"{stored} new ones in {self.config.output.root} ({pace})"
        out.append(f"{len(self.references)} demonstrations in, {new}.")
        attempts = self.summary.get("attempts", stored)
        if attempts >= FEW_ATTEMPTS and stored < FEW_WORKED * attempts:
            out.append(
                f"Only {stored} of {attempts} attempts did the task: are the demonstrations of this task and"
                f" of the twin's finger, {self.subject()[0].length_mm:g} mm long (--twin)?"
            )
        if start_range := self.summary.get("start_range_m"):
            reach = " / ".join(f"{1e3 * each:.0f}" for each in start_range)
            out.append(f"They start up to {reach} mm (x / y / z) away from recorded starts (--start_range).")
        if late := self.summary.get("answer_delay_frames"):
            earlier = "pneutac_bc learns to answer earlier, by at most 0.2 s (--policy.answer_delay)"
            out.append(f"The demonstrator answers a touch {plural(late, 'frame')} late; {earlier}.")
        if copies := self.summary.get("copies", 0):
            mixed = "so that training on it mixes both (--real_share); do not merge it with them again"
            times = plural(copies // len(self.references), "time")
            out.append(f"The dataset holds the recorded ones {times}, {mixed}.")
        elif share := self.config.real_share:
            copy = f"one copy of them would be {200 * share / (1 + share):.0f} % of its frames or more"
            remedy = "Make more (--episodes) or merge both with lerobot-edit-dataset"
            none = f"The dataset holds none of the recorded ones: --real_share={share:g}"
            out.append(f"{none}, and {copy}. {remedy}.")
        return out

    def subject(self) -> tuple[Twin, Path]:
        twin = Twin.load(self.config.twin) if self.config.twin else Twin.builtin()
        return twin, self.config.dataset.root

    @property
    def next_command(self) -> str:
        new = self.config.output
        options = [f"--dataset.repo_id={new.repo_id}", f"--dataset.root={new.root}", "--policy.device=cpu"]
        options += [f"--output_dir={new.root}_policy", "--env_eval_freq=0", "--wandb.enable=false"]
        return shlex.join(["lerobot-train", "--policy.type=pneutac_bc", *options])

    def content(self) -> dict:
        s, rmse = self.summary, [p["area_rmse"] for p in self.summary["provenance"] if "area_rmse" in p]
        out = {k: s[k] for k in ("kept", "attempts", "rejected", "wall_s", "seconds", "scenes")}
        out |= {"method": self.config.method, "copies": s.get("copies", 0), "yield": self.share}
        out |= {"start_range_m": s.get("start_range_m"), "area_rmse": float(np.mean(rmse)) if rmse else None}
        out |= {"onset_sigma_mm": 1e3 * onset_sigma_m(self.references)}
        out |= {"demonstrations_per_minute": 60 * s["kept"] / s["wall_s"]}
        out |= {"checks": s["checks"]} if "checks" in s else {}
        return out | ({"set_aside": self.failed} if self.failed else {})

    def page(self) -> Report:
        summary, references, output = self.summary, self.references, self.config.output
        report = Report(f"{summary['kept']} demonstrations from {len(references)}")
        did = f"{summary['kept']} did the task ({100 * self.share:.0f} %)"
        minutes = f"{summary['wall_s'] / 60:.1f} minutes"
        report.lead(f"{summary['attempts']} variants were tried and {did}, in {minutes}.")
        moved = "; objects and reference trajectories were moved together by as much in x and y"
        sigma = " / ".join(f"{s:.1f}" for s in 1e3 * onset_sigma_m(references))
        begin = f"within {sigma} mm (standard deviation in x / y / z){moved * bool(summary['scenes'])}"
        report.text(f"Contacts of the recorded demonstrations begin {begin}.")
        late = {line["late_commands"] for line in summary["provenance"] if "late_commands" in line}
        if late:
            fit = f"the recorded paths fit the twin best where commands act {max(late)} control steps late"
            report.text(f"Until the touch {fit}; so they do in the new demonstrations.")
        report.table(self.rows(), "Yield")
        if summary["scenes"]:
            scenes = [
                {"demonstration": r.source, "works in the twin": s["works"]}
                | {"contact area RMSE": s["area_rmse"]}
                | {"object moved (mm)": ", ".join(f"{1e3 * x:.1f}" for x in s["shift_m"][:2])}
                for r, s in zip(references, summary["scenes"], strict=False)
            ]
            stood = "Where the object stood: the replay of each recorded demonstration in the twin"
            report.table(scenes, stood)
        if "checks" in summary:
            report.table(list(map(_check_row, summary["checks"])), "Carried out once more by material points")
        report.heading("Touch")
        states = _states(output.repo_id, output.root)[: summary["kept"]]
        sources = [line["source_episode"] for line in summary["provenance"]]
        report.figure(_touch(states, sources, references), "Contact area: recorded (thick) and new (thin)")
        report.figure(_paths(states, references), "Where the contacts begin, from above")
        for sentence in self.set_aside:
            report.text(sentence)
        return report


def other_sensor(meta: "LeRobotDatasetMetadata", sensor: "TactileSensor") -> str:
    """A sentence where the twin's gel does not look at rest like that of the demonstrations; else empty.

    A policy has one image at rest: what differs from it looks like a touch. Raises InputError where they are
    of another kind of sensor, or turned.
    """
    import torch

    from lerobot_robot_pneutac.policy.tactile_encoder import SAME_SENSOR, likeness, rest_image_of
    from pneutac_sim.gel.contact import contact_area, quieted

    rest = rest_image_of(meta)
    like = likeness(rest, torch.from_numpy(sensor.rest_image.copy()).permute(2, 0, 1) / 255)
    image = (255 * rest).round().byte().permute(1, 2, 0).contiguous().numpy()
    if like is not None and like < SAME_SENSOR:
        how = f"correlation {like:.2f} with its image at rest, {SAME_SENSOR:g} needed"
        what = f"the first images of '{TACTILE}' are not of the twin's kind of sensor, or turned ({how})"
        raise InputError(f"{meta.root}: {what}; give --twin of the sensor that recorded them.")
    share = contact_area(quieted(image), quieted(sensor.rest_image), sensor.model.threshold_levels).area
    if share <= MOST_ELSEWHERE:
        return ""
    pixels = f"before a touch {100 * share:.0f} % of the pixels of '{TACTILE}' differ from the twin's image"
    why = "at rest, so that a policy trained on both takes one of the two for touched"
    remedy = "calibrate the twin's gel (pneutac calibrate), or give --twin of that sensor"
    return f"{meta.root}: {pixels} {why}; {remedy}."


def augment(
    config: AugmentConfig, progress: Progress = no_progress, note: Callable[[str], None] = lambda _: None
) -> Augmentation:
    """Augments a LeRobotDataset; writes the new one, and goes on where it was stopped.

    Before anything is made `note` is called with a sentence on the failed demonstrations, and one where the
    twin's gel looks otherwise at rest.

    Raises:
        InputError: a dataset cannot be read or exists, names no task, is of another task or sensor, fewer
            than two demonstrations have not failed, or too few variants succeed.
    """
    from pneutac_datasets.demonstrations.info import check_new

    check_new(config.output.root, config.output.repo_id)  # before imports that take seconds
    recorded = Recorded(config.dataset.root)
    progress("reading the demonstrations", 0, 1)
    from pneutac_datasets.demonstrations.augment.episode import AugmentSetup
    from pneutac_datasets.demonstrations.augment.library import start_spread_m
    from pneutac_datasets.demonstrations.augment.run import (
        NewDataset,
        augment_guided,
        augment_without_simulator,
        read_references,
    )
    from pneutac_datasets.demonstrations.episodes import POINTS, further_features
    from pneutac_datasets.demonstrations.replay.reading import task_to_do
    from pneutac_sim.gel.sensor import TactileSensor

    sensor, file = None, station_file(config.dataset.root, config.station)
    station = Station.load(file) if file else Station()
    if config.method != "naive":
        twin = Twin.load(config.twin) if config.twin else Twin.builtin()
        if faults := recorded.faults(twin, station):
            raise InputError(" ".join(faults))
        sensor = TactileSensor(twin)
    meta, references = read_references(recorded, config.dataset.repo_id, sensor)
    if faults := recorded.too_few():
        raise InputError(faults[0])
    onset_sigma_m(references)
    if sensor is not None and (other := other_sensor(meta, sensor)):
        note(other)
    for sentence in recorded.set_aside():
        note(sentence)
    size = sum(file.stat().st_size for file in recorded.folder.rglob("*") if file.is_file())
    needed = 2 * size / len(recorded.episodes) * config.episodes  # in the work folder and the dataset
    folder = next(p for p in config.output.root.absolute().parents if p.exists())
    if needed > (free := shutil.disk_usage(folder).free):
        raise InputError(
            f"episodes is {config.episodes}, which take about {needed / 1e9:.3g} GB, and {folder} has"
            f" {free / 1e9:.3g} GB free; give at most {int(config.episodes * free / needed)}."
        )
    out = NewDataset(
        config.output.root,
        config.output.repo_id,
        config.episodes,
        executor=config,
        checks=config.check_mpm,
        real_share=config.real_share or 0.0,
        device=config.device,
        worlds=config.worlds if config.device != "cpu" else 0,
    )
    if config.method == "naive":
        summary = augment_without_simulator(recorded, config.dataset.repo_id, out, config.seed, progress)
    else:
        base_m = np.array(station.base_m)  # demonstrations have positions in the arm's frame
        further = further_features(meta)
        if further and config.device != "cpu":
            raise InputError(f"device=cuda does not make {', '.join(further)} of {meta.root}; leave it out.")
        task = task_to_do(config.task, [r.task for r in references], config.dataset.root)
        placed = [replace(r, flange_m=r.flange_m + base_m) for r in references]
        start_range_m = config.start_range or start_spread_m(placed)
        cameras = {k.split(".")[-1]: tuple(f["shape"][:2]) for k, f in further.items() if k != POINTS}
        how = (config.fidelity, config.planner, config.seed, config.method, start_range_m, config.start_width)
        more = {"attempts": config.attempts, "conditions": config.conditions, "station": file}
        more |= {"tactile_points": POINTS in further, "cameras": cameras, "videos": tuple(meta.video_keys)}
        setup = AugmentSetup(placed, task, config.twin, *how, **more)
        summary = augment_guided(meta, setup, out, progress)
        summary["start_range_m"] = start_range_m if config.method != "planner" else None
    if file:
        station.save(config.output.root / "meta")
    return Augmentation(config, summary, references, recorded.failed, recorded.set_aside())


def command(config: AugmentConfig, terminal: Terminal) -> None:
    with terminal.progress() as progress:
        result = augment(config, progress, terminal.note)
    terminal.finish(result, config.out)


SHOWN = 4  # recorded demonstrations whose touch is drawn


def _check_row(check: dict) -> dict:
    row = {"demonstration": check["episode"], "does the task": check["success"]}
    row |= {"steps with touch, planned / checked": " / ".join(map(str, check["touched"]))}
    row |= {"contact area RMSE": check["area_rmse"], "largest contact area": check["area_peak"]}
    return row | {"image RMSE (levels)": check["image_rmse_levels"], "minutes": check["seconds"] / 60}


def _states(repo_id: str, root: Path) -> list[np.ndarray]:
    from lerobot.datasets import LeRobotDataset
    from lerobot.utils.constants import OBS_STATE

    dataset = LeRobotDataset(repo_id, root, video_backend="pyav")
    state = np.stack(dataset.hf_dataset.with_format("numpy")[OBS_STATE][:])
    rows = (dataset.meta.episodes[i] for i in range(dataset.num_episodes))
    return [state[r["dataset_from_index"] : r["dataset_to_index"]] for r in rows]


def _places(references: list[Reference]) -> Places:
    return Places.of(references[0].action.shape[1] - len(VELOCITY_NAMES))


def _touch(states: list[np.ndarray], sources: list[int], references: list[Reference]):
    from lerobot_pneutac.reports.figures import curves  # plotly

    places = _places(references)
    lines = []
    for state, source in zip(states, sources, strict=True):
        if source in [r.source for r in references[:SHOWN]]:
            t = np.arange(len(state)) / references[0].control_hz
            style = {"color": SERIES[source % len(SERIES)], "width": 0.7}
            lines.append(("", t, state[:, places.area], style))
    for r in references[:SHOWN]:
        t, style = np.arange(len(r)) / r.control_hz, {"color": SERIES[r.source % len(SERIES)], "width": 3}
        lines.append((f"demonstration {r.source}", t, r.area, style))
    figure = curves(lines, "time (s)", "contact area (share of the image)")
    return figure.for_each_trace(lambda trace: trace.update(showlegend=bool(trace.name)))


def _paths(states: list[np.ndarray], references: list[Reference]):
    import plotly.graph_objects as go

    places = _places(references)
    touched = [(s, np.flatnonzero(without_specks(s[:, places.area]))) for s in states]
    new = [s[frames[0], places.ee] for s, frames in touched if len(frames)]
    old = [r.flange_m[r.onset] for r in references]
    figure = go.Figure()
    for name, points, size in (("new", new, 6), ("recorded", old, 12)):
        x, y, _ = 1e3 * np.array(points).T
        figure.add_scatter(x=x, y=y, mode="markers", name=name, marker={"size": size})
    figure.update_layout(xaxis_title="flange x (mm)", yaxis_title="flange y (mm)")
    return figure
