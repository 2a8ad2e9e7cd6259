"""`pneutac benchmark surrogate`: the networks against the material points that they stand in for.

Motions and contacts are of another seed than those of the training. They are collected one by one into the
output folder, so that an interrupted run goes on.
"""

from dataclasses import dataclass
from pathlib import Path

from pneutac_sim.errors import InputError

FRESH_SEED = 1000  # far from those that people train with


@dataclass
class BenchmarkSurrogateConfig:
    """Options of `pneutac benchmark surrogate`.

    Attributes:
        twin: a finger's twin with networks; the built-in one where it is not given.
        out: folder of the table; motions and contacts in it are not collected again.
        fast: one short motion, two contacts, few steps: shows that all works.
        trajectories: held-out motions of the finger.
        seconds: of each.
        contacts: held-out presses on the gel; the five indenters take turns.
        steps: control steps that each rate of the environment is measured over.
        environments: in the batch, each in a process of its own.
        particles: of the finger, about.
        device: of the material points, `auto`, `cpu` or `cuda`; the networks run on the CPU.
        seed: of motions and contacts; another one than that of the training.
    """

    twin: Path | None = None
    out: Path = Path("outputs/benchmark_surrogate")
    fast: bool = False
    trajectories: int = 4
    seconds: float = 0.5
    contacts: int = 20
    steps: int = 200
    environments: int = 2
    particles: int = 4000
    device: str = "auto"
    seed: int = FRESH_SEED

    def __post_init__(self):
        self.out = Path(self.out)
        if self.device not in ("auto", "cpu", "cuda"):
            raise InputError(f"--device is '{self.device}'; choose auto, cpu or cuda.")
        if self.fast:
            self.trajectories, self.seconds, self.contacts, self.steps = 1, 0.06, 2, 40
        if min(self.trajectories, self.contacts, self.environments) < 1 or self.steps < 20:
            raise InputError(
                "--trajectories, --contacts and --environments must be 1 or more, and --steps 20 or more."
            )
        if self.out.exists() and not self.out.is_dir():
            raise InputError(f"--out={self.out} is a file; give a folder.")
