"""Options of an augmentation: every stage reads them here."""

from dataclasses import dataclass, field
from pathlib import Path

from pneutac_datasets.demonstrations.augment.planner import PlannerConfig
from pneutac_sim.errors import InputError, check_between, check_choice, check_least, refuse_given
from pneutac_sim.executor import MOST_WORLDS, ExecutorOptions, check_device
from pneutac_sim.features import FIDELITIES, task_names
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import MOST_WIDE
from pneutac_sim.world.checks import check_bends, check_world
from pneutac_sim.world.station import Station

METHODS = ("library", "expert", "planner", "naive")
SCENE = ("twin", "fidelity", "conditions", "station", "planner", "attempts", "device")  # not of naive ones
MOST_START_M, MOST_REAL = 0.1, 0.9
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
    # `cpu`, a world a process, or `cuda`, many worlds on a GPU, of `library` and `planner`
    device: str = "cpu"
    # worlds that are stepped together on a GPU; of `planner` those that try action sequences, planner.samples
    # of them for each plan
    worlds: int = 1024
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
        check_least(1, episodes=self.episodes, attempts=self.attempts)
        check_between(1, MOST_WORLDS, worlds=self.worlds)
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
        for name, some in (("method", ("library", "planner")), ("executor", ("local",))):
            if (value := getattr(self, name)) not in some:
                raise InputError(
                    f"device=cuda is of {name}={' or '.join(some)}, not of {value}; leave one out."
                )
        if self.method == "planner" and self.worlds < self.planner.samples:
            raise InputError(
                f"worlds is {self.worlds}; a plan needs at least planner.samples ({self.planner.samples})."
            )
        check_device(self.device)
        import pneutac_sim.world.batch  # noqa: F401  refuses where MuJoCo Warp is not installed
