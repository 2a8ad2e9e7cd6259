"""`pneutac benchmark policy`: measures what augmentation, touch and more demonstrations do for a policy.

The stand-in for reality plays the real robot: demonstrations are recorded on it and policies tried on it,
while augmentation and reinforcement learning know the twin alone. Finished units of work are kept, so a
benchmark that was stopped goes on with the same command.
"""

import importlib.util
import math
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.terminal import progress_bar
from pneutac_benchmarks.policy.plan import (
    ALIASES,
    CONDITIONS,
    MAX_SEED,
    MAX_TRIALS,
    OTHER_TASK,
    PERSON,
    plan,
)
from pneutac_sim.errors import InputError, check_choice, check_least, unknown_names
from pneutac_sim.executor import ExecutorOptions
from pneutac_sim.features import FIDELITIES, TASK_NAMES, task_names
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import MOST_WIDE
from pneutac_sim.world.checks import check_world

_FAST = {
    "tasks": ("switch",),
    "seeds": (0,),
    "trials": 1,
    "demonstrations": 2,
    "augmented": 2,
    "pretrain_updates": 30,
    "finetune_updates": 10,
    "batch": 16,
    "ppo_steps": 2000,
}


@dataclass
class BenchmarkPolicyConfig(ExecutorOptions):
    """Options of `pneutac benchmark policy`.

    Attributes:
        tasks: names of tasks.
        conditions: names of conditions; see the table.
        seeds: seeds, each with a set of demonstrations, networks and trials of its own.
        trials: number of trials of each policy, from the same starts for all policies of a seed.
        demonstrations: number of demonstrations of a set, all of them successes on the stand-in.
        person: how late, uneven and imprecise the demonstrator is, 0 (as scripted) to 1; where left out, what
            was chosen for each task.
        start_width: how much wider than the task's own the starts of demonstrations and trials are, 0 to 2;
            likewise.
        augmented: number of demonstrations made from these, or by the actor of PPO.
        real_share: share of the frames that are real ones where both are trained on at once.
        pretrain_updates: gradient steps before fine-tuning.
        finetune_updates: gradient steps of fine-tuning; conditions without pre-training make all on their
            data.
        batch: samples of a gradient step.
        lr: learning rate of Adam, where each stage begins.
        finetune_lr: learning rate of fine-tuning: lower, lest few demonstrations make the many forgotten.
        select: weights that are kept: `last`, after the last update, or `held_out`, with the lowest loss on a
            tenth of the demonstrations, at least one, which are then not trained on.
        ppo_steps: control steps of reinforcement learning.
        films: number of failed trials of each condition and task, of the first seed, of which the report has
            a film.
        device: device of the training, `cpu` or `cuda`; where left out, cuda if there is one.
        minutes: after so long no unit of work is begun, and the tables are of what is done; the same command
            goes on. Where left out, all is done.
        twin: folder of the twin for augmentation and reinforcement learning; where left out, the built-in
            one.
        fidelity: way in which finger and gel deform there: `surrogate`, by networks that fit the twin, `mpm`,
            or `probe`, by formulas.
        twin_before: folder of a twin before it was corrected: a second table compares it with `twin`, by
            augmented data alone, and fine-tuned.
        fast: tiny size, to see that it works; other options of size are not looked at.
        out: folder of all units, `result.json`, `table.md` and `report.html`.
    """

    tasks: tuple[str, ...] = TASK_NAMES
    conditions: tuple[str, ...] = tuple(CONDITIONS)
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6, 7)
    trials: int = 50
    demonstrations: int = 10
    person: float | None = None
    start_width: float | None = None
    augmented: int = 100
    real_share: float = 0.25
    pretrain_updates: int = 6000
    finetune_updates: int = 2000
    batch: int = 64
    lr: float = 1e-3
    finetune_lr: float = 1e-4
    select: str = "last"
    ppo_steps: int = 400_000
    films: int = 0
    device: str | None = None
    minutes: float | None = None
    twin: Path | None = None
    fidelity: str = "surrogate"
    twin_before: Path | None = None
    fast: bool = False
    out: Path = Path("outputs/benchmark_policy")

    def __post_init__(self):
        self.out = Path(self.out).absolute()
        if self.fast:
            vars(self).update(_FAST)
        self.check_executor()
        self.conditions = tuple(ALIASES.get(name, name) for name in self.conditions)
        self._check_lists()
        for name in ("augmented", "pretrain_updates", "finetune_updates", "batch", "ppo_steps"):
            check_least(1, **{name: getattr(self, name)})
        check_least(2, demonstrations=self.demonstrations)
        check_least(0, films=self.films)
        if not 1 <= self.trials <= MAX_TRIALS:
            raise InputError(f"trials is {self.trials}; it must be from 1 to {MAX_TRIALS}.")
        for name in ("lr", "finetune_lr"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; it must be between 0 and 1.")
        for name, most in (("person", 1), ("start_width", MOST_WIDE)):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= most:
                raise InputError(f"{name} is {value:g}; it must be from 0 to {most:g}.")
        if not 0 < self.real_share < 1:
            raise InputError(f"real_share is {self.real_share:g}; it must be between 0 and 1.")
        if self.minutes is not None and not self.minutes > 0:
            raise InputError(f"minutes is {self.minutes:g}; it must be above 0.")
        check_choice("select", self.select, ("last", "held_out"))
        self._check_twins()
        self._check_device()

    def of_task(self, task: str) -> tuple[float, float]:
        """Strength of the person and width of the starts."""
        person, width = PERSON.get(task, OTHER_TASK)
        return (
            person if self.person is None else self.person,
            width if self.start_width is None else self.start_width,
        )

    def _check_lists(self) -> None:
        for option, known in (("tasks", task_names()), ("conditions", tuple(CONDITIONS))):
            values = getattr(self, option)
            for fault in unknown_names(values, known, "name"):
                raise InputError(f"{option} has the {fault}")
            if len(set(values)) != len(values):
                raise InputError(f"{option} has a name twice; give some of {', '.join(known)}, each once.")
        if not self.tasks or not (self.conditions or self.twin_before):
            raise InputError("Give at least one of the tasks and one of the conditions.")
        seeds = self.seeds
        if not seeds or len(set(seeds)) != len(seeds) or not all(0 <= s < MAX_SEED for s in seeds):
            raise InputError(f"seeds is {list(seeds)}; give different numbers from 0 to {MAX_SEED - 1}.")

    def _check_twins(self) -> None:
        check_choice("fidelity", self.fidelity, FIDELITIES)
        for name in ("twin", "twin_before"):
            path = getattr(self, name)
            if path is None:
                continue
            check_world(Twin.load(path), self.fidelity, {})
            setattr(self, name, Path(path).absolute())

    def _check_device(self) -> None:
        import torch

        there = torch.cuda.is_available()
        self.device = self.device if self.device is not None else ("cuda" if there else "cpu")
        check_choice("device", self.device, ("cpu", "cuda"))
        if self.device == "cuda" and not there and self.executor == "local":
            raise InputError("device is 'cuda', but PyTorch finds no GPU; use cpu.")
        if "ppo" in self.conditions and importlib.util.find_spec("stable_baselines3") is None:
            raise InputError(
                "The condition 'ppo' needs Stable-Baselines3; install lerobot_robot_pneutac[rl]."
            )


def benchmark_policy(cfg: BenchmarkPolicyConfig) -> None:
    """Runs the benchmark and prints its table."""
    from pneutac_benchmarks.policy.run import finished, run_units
    from pneutac_benchmarks.policy.table import write

    console = Console()
    units, start = plan(cfg), time.time()
    left = [unit for unit in units if finished(cfg.out, unit) is None]
    core_s = sum(unit.core_s for unit in left)
    console.print(
        f"{len(units)} units of work in {cfg.out}, {len(units) - len(left)} of them done before; the others"
        f" take about {core_s / 3600:.1f} core hours.",
        highlight=False,
    )
    until = math.inf if cfg.minutes is None else start + 60 * cfg.minutes
    with progress_bar(Console(stderr=True)) as progress:
        done, failed, faults = run_units(cfg.out, units, cfg, progress, until)
    for name, why in failed.items():
        console.print(f"[yellow]not done:[/] {name}: {why}", highlight=False)
    report = write(cfg, done, failed, time.time() - start, console)
    console.print(f"Report: {report}", highlight=False)
    if not any(unit.kind == "evaluate" and unit.name in done for unit in units):
        raise InputError(f"No policy could be tried; '{cfg.out / 'table.md'}' says why.")
    if faults:
        raise InputError(f"{', '.join(faults)} ended in a fault; each one's log.txt tells which.")
