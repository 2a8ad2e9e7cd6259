"""`pneutac ppo`: trains an actor by reinforcement learning, and records its demonstrations for a student."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from pneutac_sim.errors import InputError, check_between, check_choice, check_least, refuse_given
from pneutac_sim.executor import MOST_WORLDS
from pneutac_sim.features import CHAMBERS, FIDELITIES, task_names
from pneutac_sim.twin import Twin
from pneutac_sim.world.checks import check_world
from pneutac_sim.world.station import Station

BATCH = 256  # worlds of a batch


@dataclass
class StudentRef:
    """Demonstrations that the actor gives; none where `root` is not given."""

    repo_id: str = "local/ppo"  # name of the LeRobotDataset
    root: Path | None = None  # folder of the dataset, which must not exist
    episodes: int = 50  # number of successful demonstrations
    fidelity: str = "surrogate"  # way in which finger and gel deform in them: `surrogate`, `mpm` or `probe`
    # standard deviation of what is added to the actions that are carried out, which reach from -1 to 1;
    # stored are the actions without it
    noise: float = 0.05
    video: bool = False  # tactile images as video, not PNG; datasets that are to be merged must agree

    def __post_init__(self):
        check_choice("fidelity", self.fidelity, FIDELITIES)
        check_least(1, episodes=self.episodes)
        check_between(0, 1, noise=self.noise)


@dataclass
class PpoConfig:
    """Options of `pneutac ppo`."""

    resumed_by: ClassVar = "checkpoint.safetensors"

    out: Path  # folder of the actor, its curve and the checkpoint
    # object in front of the robot: `switch`, `egg`, `card`, `fruit`, `cable`, `button`, or your own
    task: str = "switch"
    twin: Path | None = None  # folder of the finger's twin; if omitted, the built-in one
    # values that the twin's effects ask for, such as {temperature_c: 28}; every episode draws from a range
    # [low, high]
    conditions: dict[str, float | list[float]] = field(default_factory=dict)
    station: Path | None = None  # file `station.yaml` of arm, workspace and mount; if omitted, the paper's
    steps: int = 500_000  # control steps of training, of all worlds; with more than before it goes on
    seed: int = 0  # seed of networks and starts
    envs: int | None = None  # number of worlds; if omitted, two a core, at least 8, or 256 in a batch
    parallel: bool | None = None  # a process for each world; if omitted, on more than two cores
    device: str = "cpu"  # of the networks and of a batch, `cpu` or `cuda`
    # whether the worlds are stepped together by MuJoCo Warp, for switch, egg and card; if omitted, on `cuda`
    batch: bool | None = None
    # demonstrations of the actor, from which a policy with a tactile image learns; none unless their folder
    # is given
    student: StudentRef = field(default_factory=StudentRef)

    def __post_init__(self):
        check_choice("task", self.task, task_names())
        check_choice("device", self.device, ("cpu", "cuda"))
        twin = Twin.load(self.twin) if self.twin else Twin.builtin()
        if CHAMBERS.get(twin.device, 1) > 1:
            several = f"ppo trains fingers of one chamber and '{self.twin}' has several"
            remedy = "record demonstrations with --teleop.type=pneutac_scripted, and `pneutac augment` them"
            raise InputError(f"{several}; {remedy}.")
        check_world(twin, self.student.fidelity, self.conditions)
        if self.station is not None:
            Station.load(self.station).make_arm()
        if self.student.root is None and self.student != StudentRef():
            raise InputError("student has options, but no folder; give --student.root, or leave them out.")
        if self.student.root is not None and Path(self.student.root).exists():
            raise InputError(f"root is '{self.student.root}', which exists; give a new folder.")
        cores = len(os.sched_getaffinity(0))
        self.batch = self.batch if self.batch is not None else self.device == "cuda"
        if self.batch:
            refuse_given(self, ("parallel",), "is of worlds that are not stepped in a batch")
        self.envs = self.envs if self.envs is not None else BATCH if self.batch else max(8, 2 * cores)
        self.parallel = self.parallel if self.parallel is not None else cores > 2
        check_least(1, steps=self.steps)
        check_between(1, MOST_WORLDS, envs=self.envs)
