"""`pneutac benchmark surrogate`: measures the networks against the material points that they stand in for.

Motions and contacts are of another seed than those of the training. They are collected one by one into the
output folder, so that an interrupted run goes on.
"""

from dataclasses import dataclass
from pathlib import Path

from pneutac_sim.errors import check_between, check_choice, check_least
from pneutac_sim.twin import Twin
from pneutac_sim.world.checks import check_world

FRESH_SEED = 1000  # far from those that people train with


@dataclass
class BenchmarkSurrogateConfig:
    """Options of `pneutac benchmark surrogate`.

    Attributes:
        twin: folder of a finger's twin with networks; where left out, the built-in one.
        out: folder of the table; motions and contacts in it are not collected again.
        fast: tiny size, to see that it works: one short motion, two contacts, few steps.
        trajectories: number of held-out motions of the finger.
        seconds: length of each motion.
        contacts: number of held-out presses on the gel; the five indenters take turns.
        steps: control steps over which each rate of the environment is measured.
        environments: number of environments in the batch, each in a process of its own.
        particles: number of material points of the finger, about.
        device: device of the material points, `auto`, `cpu` or `cuda`; the networks run on the CPU.
        seed: seed of motions and contacts, another one than that of the training.
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
        check_choice("device", self.device, ("auto", "cpu", "cuda"))
        if self.fast:
            self.trajectories, self.seconds, self.contacts, self.steps = 1, 0.06, 2, 40
        check_least(1, trajectories=self.trajectories, contacts=self.contacts, environments=self.environments)
        check_least(20, steps=self.steps)
        check_between(0.02, 600, "s", seconds=self.seconds)
        check_least(100, particles=self.particles)
        if self.twin is not None:
            check_world(Twin.load(self.twin), "surrogate", {})
