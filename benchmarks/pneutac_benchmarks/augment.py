"""`pneutac benchmark augment`: measures demonstrations a minute, yield, and where the time goes."""

import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.reports.page import write_result
from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef, augment
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_sim.errors import InputError, check_choice, check_least
from pneutac_sim.features import CONTROL_HZ, TASK_NAMES, TRIAL_S, task_names
from pneutac_sim.world.base import MOST_WIDE

TOGETHER = ("building", "making", "world", "controllers", "writing", "merging")  # parts on a GPU
GUIDED = ("library", "expert", "planner")  # methods that do the task on the twin


@dataclass
class BenchmarkAugmentConfig:
    """Options of `pneutac benchmark augment`.

    Attributes:
        tasks: names of tasks.
        demonstrations: number of scripted demonstrations, recorded first.
        episodes: number of new demonstrations.
        method: how they are made, see `pneutac augment`.
        person: how late, uneven and imprecise the demonstrator is, 0 (as scripted) to 1.
        start_width: how much wider than the task's own the starts are, 0 to 2; not of the planner.
        seed: seed of every random choice.
        workers: number of processes; where left out, one a core.
        device: `cpu` or `cuda`, for library and planner, see `pneutac augment`.
        worlds: that a GPU steps together.
        out: folder of the datasets, `result.json` and `table.md`.
    """

    tasks: tuple[str, ...] = TASK_NAMES
    demonstrations: int = 4
    episodes: int = 20
    method: str = "planner"
    person: float = 0.0
    start_width: float = 0.0
    seed: int = 1
    workers: int | None = None
    device: str = "cpu"
    worlds: int = 1024
    out: Path = Path("outputs/benchmark_augment")

    def __post_init__(self):
        self.out = Path(self.out)
        for task in self.tasks or ("",):
            check_choice("tasks", task, task_names())
        check_choice("method", self.method, GUIDED)
        if not 0 <= self.person <= 1:
            raise InputError(f"person is {self.person:g}; it must be from 0 to 1.")
        if not 0 <= self.start_width <= (0 if self.method == "planner" else MOST_WIDE):
            raise InputError(
                f"start_width is {self.start_width:g}; it must be from 0 to {MOST_WIDE:g}, 0 with planner."
            )
        check_least(2, demonstrations=self.demonstrations)
        check_least(1, episodes=self.episodes, worlds=self.worlds)
        check_least(1, workers=1 if self.workers is None else self.workers)


def benchmark_augment(cfg: BenchmarkAugmentConfig) -> None:
    """Records, augments and prints the table."""
    console = Console()
    rows = [_measure(cfg, task, console) for task in cfg.tasks]
    heads = list(rows[0])
    cells = [[x if isinstance(x, str) else f"{x:.3g}" for x in r.values()] for r in rows]
    console.print(terminal("Augmentation", heads, cells, left=1))
    write_result(cfg.out, {"rows": rows})
    (cfg.out / "table.md").write_text("\n".join(markdown(heads, cells)) + "\n")


def _measure(cfg: BenchmarkAugmentConfig, task: str, console: Console) -> dict:
    """One row of the table."""
    from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
    from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
    from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
    from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
    from pneutac_datasets.demonstrations.record import record_episodes

    recorded, made = cfg.out / f"recorded_{task}", cfg.out / f"made_{task}"
    for folder in (recorded, made, made.with_name(made.name + ".work")):
        shutil.rmtree(folder, ignore_errors=True)
    cfg.out.mkdir(parents=True, exist_ok=True)
    robot = PneutacSim(PneutacSimConfig(id="twin", task=task, seed=cfg.seed, start_width=cfg.start_width))
    teleop = PneutacScripted(
        PneutacScriptedConfig(
            id="scripted", seed=cfg.seed, episode_steps=TRIAL_S * CONTROL_HZ, person=cfg.person
        )
    )
    record_episodes(robot, teleop, f"local/{recorded.name}", recorded, cfg.demonstrations, task, True)
    config = AugmentConfig(
        dataset=DatasetRef(f"local/{recorded.name}", recorded),
        output=DatasetRef(f"local/{made.name}", made),
        task=task,
        method=cfg.method,
        start_width=cfg.start_width,
        episodes=cfg.episodes,
        seed=cfg.seed,
        workers=cfg.workers,
        device=cfg.device,
        worlds=cfg.worlds,
    )
    began = time.process_time()
    with console.status(f"augmenting {task}"):
        summary = augment(config).summary
    s = summary["seconds"]
    core_s = s["core"] + s["encoding"] + time.process_time() - began  # the workers' and this process's
    core_s /= summary["kept"]
    row = {
        "task": task,
        "demonstrations a minute": 60 * summary["kept"] / summary["wall_s"],
        "yield (%)": 100 * summary["kept"] / summary["attempts"],
        "core seconds each": core_s,
        "1,000 on two cores (minutes)": 1000 * core_s / 2 / 60,
    }
    if cfg.device != "cpu":
        parts = {f"{part} (s)": s[part] for part in TOGETHER}
        return row | parts | {"wall (s)": summary["wall_s"]}
    if cfg.method != "planner":
        return row
    parts = {k: s[k] for k in ("physics", "touch", "execution", "encoding")}
    total = sum(parts.values())
    return row | {
        "planner steps a second and worker": s["planner_steps"] / (s["physics"] + s["touch"]),
        "planner physics (%)": 100 * parts["physics"] / total,
        "planner touch (%)": 100 * parts["touch"] / total,
        "carrying out (%)": 100 * parts["execution"] / total,
        "encoding (%)": 100 * parts["encoding"] / total,
    }
