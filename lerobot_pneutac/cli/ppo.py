"""`pneutac ppo`: trains an actor by reinforcement learning, and records its demonstrations for a student."""

import importlib.util
import os
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from pneutac_sim.errors import InputError
from pneutac_sim.features import FIDELITIES, TASK_NAMES
from pneutac_sim.twin import Twin


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


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(PpoConfig, argv), Console()
    if importlib.util.find_spec("stable_baselines3") is None:
        raise InputError("Stable-Baselines3 is missing; install lerobot_robot_pneutac[rl].")
    from lerobot_pneutac.rl.ppo import train_ppo

    twin = Twin.load(cfg.twin) if cfg.twin else None
    with _bar(console) as bar:
        row = bar.add_task(f"training on {cfg.task}", total=cfg.steps)

        def show(done: int, words: str) -> None:
            bar.update(row, completed=min(done, cfg.steps), description=words)

        card = train_ppo(
            cfg.task, twin, cfg.seed, cfg.steps, cfg.out, cfg.envs, cfg.parallel, cfg.device, progress=show
        )
    test = card["test"]
    table = Table(title=f"Actor for {cfg.task}")
    table.add_column("what")
    table.add_column("number", justify="right")
    table.add_row("steps of training", f"{card['steps']}")
    table.add_row("steps a second", f"{card['steps_per_s']:.0f}")
    table.add_row(f"success on {test['episodes']} new starts", f"{100 * test['success']:.0f} %")
    console.print(table)
    console.print(f"The actor and its curve are in {cfg.out}.", highlight=False)
    if cfg.student.root is not None:
        _record(cfg, twin, console)


def _record(cfg: PpoConfig, twin: Twin | None, console: Console) -> None:
    from lerobot_pneutac.rl.student import record_student

    s = cfg.student
    with _bar(console) as bar:
        row = bar.add_task("recording demonstrations", total=s.episodes)
        done = record_student(
            cfg.out,
            cfg.task,
            twin,
            s.fidelity,
            s.episodes,
            cfg.seed,
            s.root,
            s.repo_id,
            s.noise,
            s.video,
            lambda kept, trials: bar.update(row, completed=kept),
        )
    console.print(
        f"{done.episodes} demonstrations of {done.trials} trials ({100 * done.success:.0f} %) in {s.root}.",
        highlight=False,
    )


def _bar(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True)
