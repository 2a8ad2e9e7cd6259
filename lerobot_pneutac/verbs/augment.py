"""`pneutac augment`: a few demonstrations in, many new ones out, planned on the twin and guided by touch."""

import os
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from pneutac_datasets.demonstrations.augment.planner import PlannerConfig
from pneutac_sim.errors import InputError
from pneutac_sim.features import FIDELITIES, TASK_NAMES

METHODS = ("tactile", "naive")


@dataclass
class DatasetRef:
    """A LeRobotDataset.

    Attributes:
        repo_id: its name.
        root: its folder.
    """

    repo_id: str = ""
    root: Path | None = None


@dataclass
class AugmentConfig:
    """Options of `pneutac augment`.

    Attributes:
        dataset: the recorded demonstrations.
        output: the new ones; the folder must not exist.
        task: what stands in front of the robot: `switch`, `egg` or `card`.
        method: `tactile` (planned in the simulator), or `naive` (varied without one, which looks at dataset,
            output, episodes and seed alone).
        episodes: new demonstrations.
        seed: decides everything.
        twin: folder of the finger's twin; default the built-in one.
        fidelity: how finger and gel deform where the plans are carried out: `surrogate`, by networks, `mpm`,
            by material points, or `probe`, by formulas; plans are made with the formulas.
        planner: horizon, samples, weights.
        attempts: variants tried for one demonstration before giving up.
        workers: processes; default one a core.
        out: folder for `report.html` and `result.json`.
    """

    dataset: DatasetRef = field(default_factory=DatasetRef)
    output: DatasetRef = field(default_factory=DatasetRef)
    task: str = "switch"
    method: str = "tactile"
    episodes: int = 100
    seed: int = 0
    twin: Path | None = None
    fidelity: str = "surrogate"
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    attempts: int = 30
    workers: int | None = None
    out: Path | None = None

    def __post_init__(self):
        for name in ("dataset", "output"):
            ref = getattr(self, name)
            if not ref.repo_id or ref.root is None:
                raise InputError(f"Give --{name}.repo_id and --{name}.root.")
            ref.root = Path(ref.root)
        choices = {"task": TASK_NAMES, "method": METHODS, "fidelity": FIDELITIES}
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise InputError(
                    f"--{name} is '{getattr(self, name)}'; it must be one of {', '.join(known)}."
                )
        self.workers = self.workers if self.workers is not None else len(os.sched_getaffinity(0))
        for name in ("episodes", "attempts", "workers"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name} is {getattr(self, name)}; it must be 1 or more.")
        if self.twin is not None and not (Path(self.twin) / "twin.yaml").is_file():
            raise InputError(f"--twin is '{self.twin}', which holds no twin.yaml; give a twin's folder.")


def augment(cfg: AugmentConfig, console: Console) -> tuple[dict, list]:
    """Runs an augmentation with a progress bar.

    Returns:
        the summary of `pneutac_datasets.demonstrations.augment.run.augment_guided`, and the references.
    """
    from pneutac_datasets.demonstrations.augment.episode import AugmentSetup
    from pneutac_datasets.demonstrations.augment.run import (
        augment_guided,
        augment_without_simulator,
        read_references,
    )
    from pneutac_sim.gel.sensor import TactileSensor
    from pneutac_sim.twin import Twin

    sensor = None
    if cfg.method == "tactile":
        sensor = TactileSensor(Twin.load(cfg.twin) if cfg.twin else None)
    meta, references = read_references(cfg.dataset.root, cfg.dataset.repo_id, sensor)
    where = (cfg.output.root, cfg.output.repo_id, cfg.episodes)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        row = bar.add_task("starting", total=None)

        def show(stage: str, done: int, total: int) -> None:
            bar.update(row, description=stage, completed=done, total=total)

        if cfg.method == "naive":
            return augment_without_simulator(meta, *where, cfg.seed, show), references
        setup = AugmentSetup(
            references, cfg.task, cfg.twin, cfg.fidelity, cfg.planner, cfg.seed, attempts=cfg.attempts
        )
        return augment_guided(meta, setup, *where, cfg.workers, show), references


def main(argv: list[str]) -> None:
    """Augments; prints a table, and writes a report where `--out` says."""
    cfg = parse_options(AugmentConfig, argv)
    console = Console()
    summary, references = augment(cfg, console)
    table = Table(title=f"Augmentation of {cfg.dataset.repo_id} ({cfg.method})")
    table.add_column("variants")
    table.add_column("number", justify="right")
    table.add_row("kept", str(summary["kept"]))
    for reason, count in summary["rejected"].items():
        table.add_row(f"rejected: {reason}", str(count))
    table.add_row("yield", f"{100 * summary['kept'] / summary['attempts']:.0f} %")
    console.print(table)
    minutes = summary["wall_s"] / 60
    console.print(
        f"{len(references)} demonstrations in, {summary['kept']} new ones in {cfg.output.root}"
        f" ({minutes:.1f} minutes, {summary['kept'] / minutes:.0f} a minute)."
    )
    if cfg.out:
        from lerobot_pneutac.reports.augment import write_augment_report

        console.print(f"Report: {write_augment_report(cfg, summary, references)}")
