"""`pneutac benchmark body`: how well a soft finger is drawn from one photograph, and calibrated from six."""

from dataclasses import dataclass
from pathlib import Path

from pneutac_sim.errors import InputError

PARTS = ("looks", "shape")


@dataclass
class BenchmarkBodyConfig:
    """Options of `pneutac benchmark body`.

    Attributes:
        part: `looks` (the paper's Table I), `shape` (bodies calibrated from photographs) or `all`.
        out: folder of the tables; photographs and calibrated bodies in it are not made again.
        fast: looks: one body at three pressures, with a short training of the radiance field. Shape: one
            finger and one hidden effect, with one generation of the search.
        bodies: looks: fingers with hidden parameters, looks and lamps.
        step_kpa: looks: between pressures from 0 to 15 kPa.
        fingers: shape: hidden fingers of the model's own form.
        arms: shape: hidden arms of the model's own form.
        hidden: shape: fingers with each hidden effect.
        evaluations: shape: of the objective, a body.
        first_seed: of the first body.
        particles: of a body, about.
        device: of the material points, `auto`, `cpu` or `cuda`.
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
        if self.part not in (*PARTS, "all"):
            raise InputError(f"--part={self.part} must be one of {', '.join(PARTS)}, all.")
        if self.bodies < 1 or not 0 < self.step_kpa <= 15 or self.particles < 100:
            raise InputError("--bodies must be 1 or more, --step_kpa above 0 to 15, --particles 100 or more.")
        if min(self.fingers, self.arms, self.hidden) < 0 or self.fingers + self.arms + self.hidden < 1:
            raise InputError("--fingers, --arms and --hidden must be 0 or more, and not all 0.")
        if self.fast:
            self.bodies, self.step_kpa = 1, 7.5
            self.fingers, self.arms, self.hidden, self.evaluations, self.particles = 1, 0, 1, 7, 1500
