"""`pneutac augment`: a few demonstrations in, many new ones out, planned on the twin and guided by touch."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.verbs.result import Result
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


@dataclass(frozen=True)
class Augmentation(Result):
    """What an augmentation came to.

    Attributes:
        config: what was asked for.
        summary: `kept`, `attempts`, `rejected` (reason to number), `wall_s`, and what the provenance tells.
        references: the recorded demonstrations.
    """

    config: AugmentConfig
    summary: dict
    references: list

    @property
    def title(self) -> str:
        """Heading of the table."""
        return f"Augmentation of {self.config.dataset.repo_id} ({self.config.method})"

    @property
    def share(self) -> float:
        """Of the variants that were tried, those that did the task."""
        return self.summary["kept"] / self.summary["attempts"]

    def rows(self) -> list[dict]:
        """Variants and their number."""
        counts = {"kept": self.summary["kept"]}
        counts |= {f"rejected: {reason}": count for reason, count in self.summary["rejected"].items()}
        counts["yield"] = f"{100 * self.share:.0f} %"
        return [{"variants": name, "number": number} for name, number in counts.items()]

    def remarks(self) -> list[str]:
        """How many, where and how fast."""
        kept, minutes = self.summary["kept"], self.summary["wall_s"] / 60
        return [
            f"{len(self.references)} demonstrations in, {kept} new ones in {self.config.output.root}"
            f" ({minutes:.1f} minutes, {kept / minutes:.0f} a minute)."
        ]

    def to_dict(self) -> dict:
        """As in `result.json`."""
        from lerobot_pneutac.reports.augment import augment_result

        return augment_result(self.config.method, self.summary, self.references)

    def page(self) -> Report:
        """The report."""
        from lerobot_pneutac.reports.augment import augment_page

        new = (self.config.output.repo_id, self.config.output.root)
        return augment_page(new, self.summary, self.references)


def augment(
    config: AugmentConfig, progress: Callable[[str, int, int], None] = lambda *a: None
) -> Augmentation:
    """Augments a LeRobotDataset; writes the new one, and goes on where it was stopped.

    Raises:
        InputError: a dataset cannot be read or exists, or too few variants succeed.
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
    if config.method == "tactile":
        sensor = TactileSensor(Twin.load(config.twin) if config.twin else None)
    meta, references = read_references(config.dataset.root, config.dataset.repo_id, sensor)
    new = (config.output.root, config.output.repo_id, config.episodes)
    if config.method == "naive":
        summary = augment_without_simulator(meta, *new, config.seed, progress)
    else:
        setup = AugmentSetup(
            references,
            config.task,
            config.twin,
            config.fidelity,
            config.planner,
            config.seed,
            attempts=config.attempts,
        )
        summary = augment_guided(meta, setup, *new, config.workers, progress)
    return Augmentation(config, summary, references)
