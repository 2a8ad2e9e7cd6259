"""`pneutac benchmark diagnosis`: whether the diagnosis finds what a device does, and says so where not."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions

SETS = ("truths", "real", "extrapolation", "own_form_out", "rivals", "logs", "lab")
DEVICES = ("rod", "arm", "cosserat")


@dataclass
class BenchmarkDiagnosisConfig(ExecutorOptions):
    """Options of `pneutac benchmark diagnosis`.

    Attributes:
        set: `truths` (devices that share nothing with the twin, judged on another day), `real`
            ($PNEUTAC_DATA/soft), `extrapolation` (truths, learnt below 60 % of the pressure), `own_form_out`
            (without the truth's families), `rivals` (other methods), `logs` (ordinary logs of plain fingers,
            which must raise no alarm, and some with one effect) or `lab` (truths with turned, loaded and
            warm runs: calibrated, diagnosed, added, compared on another day, then effects added that are not
            there).
        out: folder of the table; finished cases in it are not repeated. Where left out,
            outputs/benchmark_diagnosis/SET.
        fast: one seed, few cases and four-minute recordings only.
        seeds: devices or recordings of each kind; splits of a real one; of `logs`, plain fingers.
        first_seed: seed of the first device or recording; another one makes another, equally blind test.
        minutes: length of each recording; a cosserat rod is always recorded for two.
        devices: names of devices, of truths, with commas between.
        effects: names of effects, of truths, with commas; where left out, all, pairs, `plain` and `device`.
        pauses: whether both days of truths state how long the device rested before each run.
    """

    set: str = "truths"
    out: Path | None = None
    fast: bool = False
    seeds: int = 5
    first_seed: int = 0
    minutes: float = 10.0
    devices: tuple[str, ...] = DEVICES
    effects: tuple[str, ...] = ()
    pauses: bool = False

    def __post_init__(self):
        if self.set not in SETS:
            raise InputError(f"--set={self.set} must be one of {', '.join(SETS)}.")
        if self.seeds < 1 or not 1 <= self.minutes <= 60:
            raise InputError("--seeds must be 1 or more, --minutes 1 to 60.")
        self.check_executor()
        self.out = self.out or Path("outputs/benchmark_diagnosis") / self.set
        unknown = sorted(set(self.devices) - set(DEVICES))
        if unknown:
            raise InputError(f"--devices={','.join(unknown)} must be some of {', '.join(DEVICES)}.")
        if self.fast:
            self.seeds, self.minutes = 1, min(self.minutes, 4.0)


@dataclass(frozen=True)
class Case:
    """One diagnosis, or one comparison of methods.

    Attributes:
        set: one of `SETS`.
        kind: within the set: `effect`, `pair`, `plain`, `device`; or how a real one is split.
        effects: names, joined by commas.
        seed: of everything random.
        minutes: of the recording.
        device: of a truth, or the folder of a real recording.
        pauses: whether a truth's recordings state them.
    """

    set: str
    kind: str
    effects: str
    seed: int
    minutes: float = 0.0
    device: str = ""
    pauses: bool = False

    @property
    def key(self) -> str:
        """File name of its answer."""
        parts = (self.kind, self.device, self.effects.replace(",", "+"), str(self.seed))
        return "_".join(p for p in (*parts, f"{self.minutes:g}min", "pauses" * self.pauses) if p)


def diagnosed(twin, recording, seed: int, wanted: Callable[[str], bool] | None = None):
    """A diagnosis in one thread.

    Args:
        twin: as it is.
        recording: to learn from.
        seed: of the split.
        wanted: which effects and laws may be tried, as candidates or as a line or part of the base; all where
            None.
    """
    from lerobot_pneutac.diagnosis.search import Steps
    from lerobot_pneutac.study import study_of
    from lerobot_pneutac.verbs.diagnose import Diagnosis
    from pneutac_sim.effects.registry import body_effects

    study = study_of(twin, recording, seed)
    if wanted is not None:
        study.candidates = [c for c in study.candidates if wanted(c)]
        study.excluded = [e for e in body_effects() if not wanted(e)]
    return Diagnosis(study=study, outcome=study.search(1, Steps()))
