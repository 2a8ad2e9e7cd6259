"""`pneutac benchmark body`: measures how a soft finger is drawn from one photograph, calibrated from six."""

from dataclasses import dataclass
from pathlib import Path

from pneutac_sim.errors import InputError, check_choice, check_least

PARTS = ("looks", "shape")


@dataclass
class BenchmarkBodyConfig:
    """Options of `pneutac benchmark body`.

    Attributes:
        part: `looks` (the paper's Table I), `shape` (bodies calibrated from photographs) or `all`.
        out: folder of the tables; photographs and calibrated bodies in it are not made again.
        fast: tiny size, to see that it works. Looks: one body at three pressures, with a short training of
            the radiance field. Shape: one finger and one hidden effect, with one generation of the search.
        bodies: number of fingers with hidden parameters, looks and lamps, for the looks.
        step_kpa: step between pressures from 0 to 15 kPa, for the looks.
        fingers: number of hidden fingers of the model's own form, for the shape.
        arms: number of hidden arms of the model's own form, for the shape.
        hidden: number of fingers with each hidden effect, for the shape.
        evaluations: number of bodies that a search tries, for the shape.
        first_seed: seed of the first body.
        particles: number of material points of a body, about.
        device: device of the material points, `auto`, `cpu` or `cuda`.
    """

    part: str = "all"
    out: Path = Path("outputs/benchmark_body")
    fast: bool = False
    bodies: int = 2
    step_kpa: float = 1.0
    fingers: int = 6
    arms: int = 1
    hidden: int = 2
    evaluations: int = 84
    first_seed: int = 10
    particles: int = 4000
    device: str = "auto"

    def __post_init__(self):
        self.out = Path(self.out)
        check_choice("part", self.part, (*PARTS, "all"))
        check_least(1, bodies=self.bodies, evaluations=self.evaluations)
        check_least(100, particles=self.particles)
        check_least(0, fingers=self.fingers, arms=self.arms, hidden=self.hidden)
        if not 0 < self.step_kpa <= 15:
            raise InputError(f"step_kpa is {self.step_kpa}; it must be above 0 and at most 15.")
        if not self.fingers + self.arms + self.hidden:
            raise InputError("fingers is 0, as arms and hidden are; give at least one.")
        if self.fast:
            self.bodies, self.step_kpa = 1, 7.5
            self.fingers, self.arms, self.hidden, self.evaluations, self.particles = 1, 0, 1, 7, 1500
