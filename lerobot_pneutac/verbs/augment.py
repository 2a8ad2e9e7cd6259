"""`pneutac augment`: makes many demonstrations out of a few, carried out on the twin."""

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.demonstrations import faults as recorded
from pneutac_datasets.demonstrations.augment.planner import PlannerConfig
from pneutac_datasets.demonstrations.augment.reference import onset_sigma_m
from pneutac_datasets.demonstrations.faults import TACTILE
from pneutac_sim.errors import InputError, check_choice, check_least
from pneutac_sim.executor import ExecutorOptions
from pneutac_sim.features import FIDELITIES, task_names
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import MOST_WIDE
from pneutac_sim.world.checks import check_bends, check_world
from pneutac_sim.world.station import Station, station_file

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata

    from pneutac_sim.gel.sensor import TactileSensor

METHODS = ("library", "expert", "planner", "naive")
MOST_START_M, MOST_REAL = 0.1, 0.9
MOST_ELSEWHERE = 0.05  # share of the pixels that differ from the twin's image at rest; more is noted
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
    # `library` (a controller made of the demonstrations, which starts anywhere and finds the object by
    # touch), `expert` (the scripted controller that the task brings), `planner` (each is planned, guided by
    # one demonstration's touch; `tactile` is its former name), or `naive` (varied without a simulator; looks
    # at dataset, output, episodes and seed alone)
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
        if self.start_range is not None:
            if not anywhere:
                raise InputError(f"start_range is of library and expert, not of {self.method}; leave it out.")
            if not all(0 <= x <= MOST_START_M for x in self.start_range):
                raise InputError(f"start_range must be three numbers of 0 to {MOST_START_M} m.")
        if not 0 <= self.start_width <= MOST_WIDE:
            raise InputError(f"start_width is {self.start_width:g}; it must be from 0 to {MOST_WIDE:g}.")
        if self.start_width and not anywhere:
            raise InputError(f"start_width is of library and expert, not of {self.method}; leave it out.")
        if anywhere and self.planner != PlannerConfig():
            raise InputError(f"planner has options that {self.method} does not use; give method=planner.")
        if self.real_share is None:
            self.real_share = REAL_SHARE if anywhere else 0.0
        if not 0 <= self.real_share <= MOST_REAL or (self.real_share and self.method == "naive"):
            raise InputError(f"real_share must be 0 to {MOST_REAL:g}, and 0 with naive.")
        check_choice("fidelity", self.fidelity, FIDELITIES)
        self.check_executor()
        check_least(1, episodes=self.episodes, attempts=self.attempts, worlds=self.worlds)
        if self.device != "cpu":
            self._check_device()
        check_least(0, check_mpm=self.check_mpm)
        if self.check_mpm and self.method == "naive":
            raise InputError("check_mpm carries demonstrations out; naive ones have no scene; leave it out.")
        if self.check_mpm and self.fidelity == "mpm":
            raise InputError("check_mpm compares with what fidelity=mpm is already; leave it out.")
        twin = Twin.load(self.twin) if self.twin else Twin.builtin()
        if self.method != "naive":
            check_world(twin, self.fidelity, self.conditions)
            if self.check_mpm:
                check_bends(twin, "mpm")
        if self.station is not None:
            Station.load(self.station).make_arm()

    def _check_device(self) -> None:
        check_choice("device", self.device, ("cpu", "cuda"))
        if self.method != "library":
            raise InputError(f"device=cuda is of method=library, not of {self.method}; leave it out.")
        if self.executor != "local":
            raise InputError(f"device=cuda is of executor=local, not of {self.executor}; leave one out.")
        import torch

        if not torch.cuda.is_available():
            raise InputError("device is 'cuda', but PyTorch finds no CUDA device here; leave it out.")
        import pneutac_sim.world.batch  # noqa: F401  refuses where MuJoCo Warp is not installed


@dataclass(frozen=True)
class Augmentation(Result):
    """What an augmentation came to."""

    heading = "Augmentation of {0.config.dataset.repo_id} ({0.config.method})"

    config: AugmentConfig
    summary: dict  # `kept`, `attempts`, `rejected` (reason to number), `wall_s`, and the provenance
    references: list  # the recorded demonstrations that were used
    failed: dict[int, str] = field(default_factory=dict)  # the others, number to why each was set aside

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
        out.append(
            f"{len(self.references)} demonstrations in, {stored} new ones in {self.config.output.root}"
            f" ({minutes:.1f} minutes, {stored / minutes:.0f} a minute)."
        )
        if start_range := self.summary.get("start_range_m"):
            reach = " / ".join(f"{1e3 * each:.0f}" for each in start_range)
            out.append(f"They start up to {reach} mm (x / y / z) away from recorded starts (--start_range).")
        if late := self.summary.get("answer_delay_frames"):
            out.append(
                f"The demonstrator answers a touch {late} frame{'s' * (late > 1)} late; pneutac_bc learns to"
                " answer earlier, by at most 0.2 s (--policy.answer_delay)."
            )
        if copies := self.summary.get("copies", 0):
            times = copies // len(self.references)
            out.append(
                f"The dataset holds the recorded ones {times} time{'s' * (times > 1)}, so that training on it"
                " mixes both (--real_share); do not merge it with them again."
            )
        elif share := self.config.real_share:
            out.append(
                f"The dataset holds none of the recorded ones: --real_share={share:g}, and one copy of them"
                f" would be {200 * share / (1 + share):.0f} % of its frames or more. Make more (--episodes)"
                " or merge both with lerobot-edit-dataset."
            )
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
        from lerobot_pneutac.reports.augment import augment_page

        return augment_page(self)


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
        raise InputError(
            f"{meta.root}: the first images of '{TACTILE}' are not of the twin's kind of sensor, or turned"
            f" (correlation {like:.2f} with its image at rest, {SAME_SENSOR:g} needed); give --twin of the"
            " sensor that recorded them."
        )
    share = contact_area(quieted(image), quieted(sensor.rest_image), sensor.model.threshold_levels).area
    if share <= MOST_ELSEWHERE:
        return ""
    return (
        f"{meta.root}: before a touch {100 * share:.0f} % of the pixels of '{TACTILE}' differ from the twin's"
        " image at rest, so that a policy trained on both takes one of the two for touched; calibrate the"
        " twin's gel (pneutac calibrate), or give --twin of that sensor."
    )


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
    from pneutac_datasets.demonstrations.info import check_new, info_file, refuse_damaged

    check_new(config.output.root, config.output.repo_id)  # before imports that take seconds
    info_file(config.dataset.root)
    progress("reading the demonstrations", 0, 1)
    from pneutac_datasets.demonstrations.augment.episode import AugmentSetup
    from pneutac_datasets.demonstrations.augment.library import start_spread_m
    from pneutac_datasets.demonstrations.augment.run import (
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
        faults = recorded.demonstration_faults(config.dataset.root, twin, station)
        if faults:
            raise InputError(" ".join(faults))
        sensor = TactileSensor(twin)
    else:
        refuse_damaged(config.dataset.root)
    failed = recorded.failed_demonstrations(config.dataset.root)
    meta, references = read_references(config.dataset.root, config.dataset.repo_id, sensor, failed)
    if faults := recorded.too_few(config.dataset.root, meta.total_episodes, failed):
        raise InputError(faults[0])
    onset_sigma_m(references)
    if sensor is not None and (other := other_sensor(meta, sensor)):
        note(other)
    if failed:
        note(recorded.set_aside(config.dataset.root, meta.total_episodes, failed))
    new = (config.output.root, config.output.repo_id, config.episodes)
    if config.method == "naive":
        summary = augment_without_simulator(meta, *new, config.seed, progress, failed)
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
        more |= {"tactile_points": POINTS in further, "cameras": cameras}
        setup = AugmentSetup(placed, task, config.twin, *how, **more)
        together = (config.device, config.worlds) if config.device != "cpu" else ()
        how = (config.check_mpm, config.real_share, *together)
        summary = augment_guided(meta, setup, *new, config, progress, *how)
        summary["start_range_m"] = start_range_m if config.method != "planner" else None
    if file:
        station.save(config.output.root / "meta")
    return Augmentation(config, summary, references, failed)


def command(config: AugmentConfig, terminal: Terminal) -> None:
    """Generates many demonstrations from a few, planned on the twin and guided by touch."""
    with terminal.progress() as progress:
        result = augment(config, progress, terminal.note)
    terminal.finish(result, config.out)
