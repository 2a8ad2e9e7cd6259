"""How far a twin is from a recording, and where it fails.

How a device ages: one twin against recordings of several dates, and when to calibrate it again.
"""

import shlex
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path
from typing import ClassVar

import numpy as np

from lerobot_pneutac.cli.options import PairOptions, keywords
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.reports.page import rows_of
from lerobot_pneutac.study.pair import load_bench_pair, load_pair, no_demonstrations, same_body
from lerobot_pneutac.verbs.result import Comparison, Result
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.executor import Progress, no_progress, one_thread
from pneutac_sim.twin import Twin

FIDELITIES = ("pipeline", "mpm")


@one_thread
def compare(
    twin: Twin,
    recording: Recording | Demonstrations,
    *,
    fidelity: str = "pipeline",
    samples: int | None = None,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Comparison:
    """Runs the twin on what a recording commanded and sorts the errors; neither is changed.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel; or demonstrations of a robot with the finger, which are
            replayed in the twin's world.
        fidelity: `pipeline` (the twin's kinematics, every sample) or `mpm` (of a finger or an arm: the full
            body of material points, at samples spread over the recording).
        samples: largest number of samples by mpm; if omitted, 200.
        seed: seed of the choice of the samples by mpm, and of the demonstrations that are held out.
        progress: called with a text, the steps done and all of them.

    Raises:
        InputError: the devices differ, or an effect cannot act in the full simulation.
    """
    check_fidelity(fidelity, samples)
    if isinstance(recording, Demonstrations) and fidelity != "pipeline":
        raise InputError(f"fidelity={fidelity} does not replay demonstrations; omit it.")
    recording = same_body(twin, recording, "compare")
    if isinstance(recording, Demonstrations):
        from lerobot_pneutac.verbs.compare_demonstrations import compare_demonstrations

        return compare_demonstrations(twin, recording, seed, progress)
    if recording.device == "gel":
        if fidelity != "pipeline":
            raise InputError(f"fidelity={fidelity} is of a finger or an arm, not of a gel; omit it.")
        from lerobot_pneutac.verbs.fit_gel import compare_gel

        return compare_gel(twin, recording)
    from lerobot_pneutac.verbs.compare_body import SAMPLES, by_mpm, compare_body

    whole = compare_body(twin, recording)
    return whole if fidelity == "pipeline" else by_mpm(whole, twin, samples or SAMPLES, seed, progress)


AGAIN = 1.5  # times the first date's error, above which a twin is calibrated again
DRAWS = 400  # of whole blocks of time, for the interval of the bend
DAYS = 30.0  # of changes


@dataclass(frozen=True)
class Date:
    """The result for the recording of one date."""

    day: date
    name: str
    error: float  # root mean square over all of its samples
    bend: float  # how far it bends, as a share of what the twin says, 1 for a twin that is right
    half: float  # half-width of its 95 % interval
    travel: float  # root mean square of the twin's own motion about its mean, in the error's unit

    @property
    def ci95(self) -> list[float]:
        return [self.bend - self.half, self.bend + self.half]


@dataclass(frozen=True, kw_only=True)
class Ageing(Result):
    """One device on several dates."""

    dates: tuple[Date, ...]
    unit: str
    twin: Twin
    findings: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        return f"Ageing over {(self.dates[-1].day - self.dates[0].day).days} days"

    @property
    def slope(self) -> tuple[float, float]:
        """Change of the bend a day, as a share, and the half-width of its interval, by weighted lines."""
        days = np.array([(d.day - self.dates[0].day).days for d in self.dates], float)
        weight = 1 / np.square([d.half for d in self.dates])
        deviation = days - np.average(days, weights=weight)
        spread = float(np.sum(weight * deviation**2))
        return float(np.sum(weight * deviation * [d.bend for d in self.dates])) / spread, spread**-0.5

    @property
    def again(self) -> date | None:
        """When to calibrate again: the day, or None where nothing asks for it within ten years.

        A bend that is wrong by s gives the error sqrt(e^2 + (s travel)^2).
        """
        first, last = self.dates[0], self.dates[-1]
        if last.error > AGAIN * first.error:
            return last.day
        slope, half = self.slope
        if abs(slope) <= half:
            return None
        wrong = (AGAIN**2 - 1) ** 0.5 * first.error / first.travel
        days = wrong / abs(slope)
        return first.day + timedelta(days=round(days)) if days < 3650 else None

    @property
    def sentence(self) -> str:
        first, last, (slope, half), again = self.dates[0], self.dates[-1], self.slope, self.again
        every, within = f"every {DAYS:.0f} days", f"{100 * half * DAYS:.1g} %"
        text = f"No change of the bend is significant (within {within} {every})"
        if abs(slope) > half:
            word = "more" if slope > 0 else "less"
            text = f"It bends {100 * abs(slope) * DAYS:.2g} % {word} {every} (± {within})"
        due = "no new calibration is due"
        if again is not None:
            when = "now" if last.error > AGAIN * first.error else f"about {again.isoformat()}"
            due = f"calibrate it again {when}"
        return f"{text}; the error went from {first.error:.2g} to {last.error:.2g} {self.unit}: {due}."

    def rows(self) -> list[dict]:
        columns = {"date": "{0.day}", "recording": "name", f"error ({self.unit})": "error"}
        return rows_of(self.dates, columns | {"bend, times the twin's": "{0.bend:.3f} ± {0.half:.3f}"})

    def remarks(self) -> list[str]:
        due = f"A calibration is due where the error exceeds {AGAIN:g} times that of the first date"
        return [f"{due}; the day ahead follows from the change of the bend alone."]

    def content(self) -> dict:
        (slope, half), again = self.slope, self.again
        columns = {"date": "{0.day}", "recording": "name", "error": "error", "bend": "bend"}
        dates = rows_of(self.dates, columns | {"bend_ci95": "ci95"})
        change = {"value": slope, "ci95": [slope - half, slope + half]}
        out = {"unit": self.unit, "dates": dates, "bend_change_per_day": change}
        return out | {"calibrate_again": again and again.isoformat()}


def ageing(twin: Twin, recordings: list[Recording], seed: int = 0) -> Ageing:
    """How far a finger's or an arm's twin, calibrated on the first date, is from its device on several dates.

    Raises InputError where there are fewer than two, a recording has no `date`, or it is of a gel.
    """
    from lerobot_pneutac.verbs.compare_body import compare_body

    days = [_day(r) for r in recordings]
    if len(set(days)) < 2:
        raise InputError("Ageing takes recordings of two dates or more.")
    order = sorted(range(len(days)), key=days.__getitem__)
    compared = [compare_body(twin, recordings[k]) for k in order]
    rng = np.random.default_rng(seed)
    dates = tuple(_date(days[k], c, rng) for k, c in zip(order, compared, strict=True))
    findings = tuple(f"{d.name}: {f}" for d, c in zip(dates, compared, strict=True) for f in c.findings)
    return Ageing(dates=dates, unit=compared[0].unit, twin=twin, findings=findings)


def _day(recording: Recording) -> date:
    file = Path(recording.folder) / "recording.json"
    if recording.device == "gel":
        raise InputError(f"{file}: ageing is computed for a finger or an arm, and this is of a gel.")
    value = recording.meta.get("date")
    try:
        return date.fromisoformat(value or "")
    except (TypeError, ValueError):
        found = "missing" if value is None else repr(value)
        if tables := recording.meta.get("source", {}).get("files"):  # a conversion would overwrite the field
            table = shlex.quote(",".join(str(file.parent.parent / name) for name in tables))
            again = (
                f"pneutac convert {table} --mapping={file.parent}/mapping.yaml --date=2026-03-01 --replace"
            )
            raise InputError(f"{table}: the date is {found}; give it, as by `{again}`.") from None
        remedy = 'give the day of the measurement, such as "2026-03-01"'
        raise InputError(f"{file}: field 'date' is {found}; {remedy}.") from None


def _date(day: date, c, rng: np.random.Generator) -> Date:
    """One date: the bend is the factor on the twin's own motion that fits the measurement best."""
    model, measured = c.model[:, : c.counted], c.measured[:, : c.counted]
    block = c.recording.blocks()
    numbers, at = np.unique(block, return_inverse=True)
    # Sums of each block, from which any choice of blocks gives its means and products.
    sums = np.zeros((len(numbers), 3 + 2 * c.counted))
    parts = (np.ones(len(at)), (model * measured).sum(1), (model**2).sum(1), *model.T, *measured.T)
    for column, part in enumerate(parts):
        sums[:, column] = np.bincount(at, part)

    def bend(s: np.ndarray) -> float:
        n, product, square = s[:3]
        m, d = s[3 : 3 + c.counted], s[3 + c.counted :]
        return float((product - m @ d / n) / (square - m @ m / n))

    drawn = [bend(sums[rng.integers(len(numbers), size=len(numbers))].sum(0)) for _ in range(DRAWS)]
    low, high = np.quantile(drawn, [0.025, 0.975])
    travel = float(np.sqrt(np.square(model - model.mean(0)).sum(1).mean()))
    name = Path(c.recording.folder).name
    return Date(day, name, float(c.error["all"] or 0.0), bend(sums.sum(0)), (high - low) / 2, travel)


def check_fidelity(fidelity: str, samples: int | None) -> None:
    check_choice("fidelity", fidelity, FIDELITIES)
    if samples is not None and (samples < 2 or fidelity != "mpm"):
        raise InputError(f"samples={samples} must be 2 or more, together with fidelity=mpm.")


@dataclass
class CompareConfig(PairOptions):
    """Options of `pneutac compare`.

    Attributes:
        recording: folder of a bench recording, or tables as `pneutac convert` reads them of the same device;
            or of a LeRobotDataset of demonstrations, or its name on the Hub, which are replayed in the twin's
            world.
    """

    described_by: ClassVar = compare

    fidelity: str = "pipeline"
    samples: int | None = None
    # recordings of the same finger or arm on other dates: how it ages, when to calibrate it again
    later: list[Path] = field(default_factory=list)
    seed: int = 0

    def __post_init__(self):
        check_fidelity(self.fidelity, self.samples)
        if self.later and self.fidelity != "pipeline":
            raise InputError(f"later is compared by the pipeline, not by fidelity={self.fidelity}; omit it.")


def command(cfg: CompareConfig, terminal: Terminal) -> None:
    if cfg.later:
        no_demonstrations(cfg.recording, cfg.task, cfg.station)
        pairs = [load_bench_pair(cfg.twin, p, "compute ageing from") for p in (cfg.recording, *cfg.later)]
        terminal.finish(ageing(pairs[0][0], [recording for _, recording in pairs], cfg.seed), cfg.out)
        return
    twin, recording = load_pair(cfg.twin, cfg.recording, "compare", cfg.task, cfg.station)
    terminal.finish(terminal.run(compare, twin, recording, **keywords(cfg, compare)), cfg.out)
