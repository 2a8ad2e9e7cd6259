"""`pneutac ppo`: trains an actor by reinforcement learning, and records its demonstrations for a student."""

import os
from dataclasses import dataclass, field
from pathlib import Path

from pneutac_sim.errors import InputError
from pneutac_sim.features import FIDELITIES, TASK_NAMES


@dataclass
class StudentRef:
    """Demonstrations that the actor gives; none where `root` is not given.

    Attributes:
        repo_id: name of the LeRobotDataset.
        root: its folder, which must not exist.
        episodes: successful demonstrations.
        fidelity: how finger and gel deform in them: `surrogate`, `mpm` or `probe`.
        noise: standard deviation of what is added to the actions that are carried out, which reach from -1
            to 1; stored are the actions without it.
        video: store the tactile images as video instead of PNG; datasets that are to be merged must agree in
            this.
    """

    repo_id: str = "local/ppo"
    root: Path | None = None
    episodes: int = 50
    fidelity: str = "surrogate"
    noise: float = 0.05
    video: bool = False


@dataclass
class PpoConfig:
    """Options of `pneutac ppo`.

    Attributes:
        task: `switch`, `egg` or `card`.
        twin: folder of the finger's twin; default the built-in one.
        steps: control steps of training, of all worlds together; with more than before the training goes on.
        seed: decides networks and starts.
        envs: worlds; default two a core, at least 8.
        parallel: whether each world has a process of its own; default where there are more than two cores.
        device: `cpu` or `cuda`, of the networks; they are small, so the CPU is seldom slower.
        out: folder of the actor, its curve and the checkpoint.
        student: demonstrations of the actor, from which a policy with a tactile image learns; none unless
            their folder is given.
    """

    task: str = "switch"
    twin: Path | None = None
    steps: int = 500_000
    seed: int = 0
    envs: int | None = None
    parallel: bool | None = None
    device: str = "cpu"
    out: Path | None = None
    student: StudentRef = field(default_factory=StudentRef)

    def __post_init__(self):
        if self.out is None:
            raise InputError("Give the actor's folder with --out=DIR.")
        if self.task not in TASK_NAMES:
            raise InputError(f"--task is '{self.task}'; it must be one of {', '.join(TASK_NAMES)}.")
        if self.student.fidelity not in FIDELITIES:
            raise InputError(
                f"--student.fidelity is '{self.student.fidelity}'; it must be one of {', '.join(FIDELITIES)}."
            )
        if self.device not in ("cpu", "cuda"):
            raise InputError(f"--device is '{self.device}'; choose cpu or cuda.")
        if self.twin is not None and not (Path(self.twin) / "twin.yaml").is_file():
            raise InputError(f"--twin is '{self.twin}', which holds no twin.yaml; give a twin's folder.")
        if self.student.root is not None and Path(self.student.root).exists():
            raise InputError(f"--student.root is '{self.student.root}', which exists; give a new folder.")
        cores = len(os.sched_getaffinity(0))
        self.envs = self.envs if self.envs is not None else max(8, 2 * cores)
        self.parallel = self.parallel if self.parallel is not None else cores > 2
        for name in ("steps", "envs"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name} is {getattr(self, name)}; it must be 1 or more.")
        if self.seed < 0:
            raise InputError(f"--seed is {self.seed}; it must be 0 or more.")
