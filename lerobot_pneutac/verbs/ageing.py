"""How a device ages: one twin against recordings of several dates, and when to calibrate it again."""

from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from lerobot_pneutac.verbs.compare_body import BodyComparison, compare_body
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

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
        away = days - np.average(days, weights=weight)
        spread = float(np.sum(weight * away**2))
        return float(np.sum(weight * away * [d.bend for d in self.dates])) / spread, spread**-0.5

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
        said = f"No change of the bend is significant (within {within} {every})"
        if abs(slope) > half:
            word = "more" if slope > 0 else "less"
            said = f"It bends {100 * abs(slope) * DAYS:.2g} % {word} {every} (± {within})"
        due = "no new calibration is due"
        if again is not None:
            when = "now" if last.error > AGAIN * first.error else f"about {again.isoformat()}"
            due = f"calibrate it again {when}"
        return f"{said}; the error went from {first.error:.2g} to {last.error:.2g} {self.unit}: {due}."

    def rows(self) -> list[dict]:
        return [
            {"date": d.day.isoformat(), "recording": d.name, f"error ({self.unit})": d.error}
            | {"bend, times the twin's": f"{d.bend:.3f} ± {d.half:.3f}"}
            for d in self.dates
        ]

    def remarks(self) -> list[str]:
        return [
            f"A calibration is due where the error exceeds {AGAIN:g} times that of the first date; the day"
            " ahead follows from the change of the bend alone."
        ]

    def content(self) -> dict:
        slope, half = self.slope
        return {
            "unit": self.unit,
            "dates": [
                {"date": d.day.isoformat(), "recording": d.name, "error": d.error, "bend": d.bend}
                | {"bend_ci95": [d.bend - d.half, d.bend + d.half]}
                for d in self.dates
            ],
            "bend_change_per_day": {"value": slope, "ci95": [slope - half, slope + half]},
            "calibrate_again": None if self.again is None else self.again.isoformat(),
        }


def ageing(twin: Twin, recordings: list[Recording], seed: int = 0) -> Ageing:
    """How far a finger's or an arm's twin, calibrated on the first date, is from its device on several dates.

    Raises InputError where there are fewer than two, a recording has no `date`, or it is of a gel.
    """
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
        return date.fromisoformat(value)
    except (TypeError, ValueError):
        raise InputError(
            f"{file}: field 'date' is {value!r}; give the day of the measurement, such as \"2026-03-01\"."
        ) from None


def _date(day: date, c: BodyComparison, rng: np.random.Generator) -> Date:
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
