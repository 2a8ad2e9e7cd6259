"""What a calibration found: the next version of a twin, its parameters and its error."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from lerobot_pneutac.reports.page import span
from lerobot_pneutac.verbs.result import Result, command_on
from pneutac_datasets.recording.pressures import usable
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

WORSE = 1.02  # times the error of before: closer counts as equal


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Calibration(Result):
    """A calibrated twin; subclasses hold what is particular to markers, photographs and gels.

    Attributes:
        twin: the next version, not yet written.
        parameters: name to `value`, `unit` and, of a body, `ci95` and `note`.
        error: `train` and `heldout` root mean square error in `unit`; None where there is no such part.
        unit: of the error.
        evaluations: of the model.
        seconds: wall time.
        recording: what it was fitted to.
        change: what the twin's history says of this version.
        seed: decided which part was held out; None where roles did.
        findings: of the checks, one sentence each.
        saved_to: the twin's folder once it was saved.
    """

    twin: Twin
    parameters: dict[str, dict]
    error: dict[str, float | None]
    unit: str
    evaluations: int
    seconds: float = 0.0
    recording: str = ""
    change: str
    seed: int | None = None
    findings: tuple[str, ...] = ()
    saved_to: Path | None = None

    keys = ("parameters", "error", "unit", "evaluations", "seconds", "recording")

    @property
    def reference(self) -> tuple[str, float | None]:
        """What a fit must not be worse than on held-out samples, and its error; None without one."""
        return "", None

    @property
    def worse(self) -> str:
        """Why the fit is not stored; empty where it is as good as its reference or better."""
        what, before = self.reference
        heldout = self.error["heldout"]
        if before is None or heldout is None or heldout <= WORSE * before:
            return ""
        return (
            f"Nothing was stored: on held-out samples the fit misses by {heldout:.3g} {self.unit}, and "
            f"{what} by {before:.3g}; `pneutac check` shows what is wrong with the recording."
        )

    def save(self, folder: str | Path) -> Self:
        """Writes the twin as the next version of `folder`; returns the result that knows its place.

        Raises:
            InputError: the fit is `worse` than what was there before.
        """
        if self.worse:
            raise InputError(self.worse)
        twin = self.twin.copy()
        errors = {**self.error, "unit": self.unit} | ({} if self.seed is None else {"seed": self.seed})
        errors |= self._noted()
        twin.save_version(folder, self.change, self.recording, errors)
        return replace(self, twin=twin, saved_to=Path(folder))

    def _noted(self) -> dict:
        """What the history stores of this version besides its errors."""
        return {}

    @property
    def version(self) -> int | None:
        return self.twin.history[-1]["version"] if self.saved_to else None

    @property
    def next_command(self) -> str:
        return command_on("compare", self.twin, self.recording)

    def rows(self) -> list[dict]:
        return [
            {
                "parameter": name,
                "value": p["value"],
                "95 % interval": "" if str(p["note"]).startswith("not identifiable") else span(p["ci95"]),
                "unit": p["unit"],
                "note": p["note"],
            }
            for name, p in self.parameters.items()
        ]

    def content(self) -> dict:
        where = {"twin": self.saved_to, "version": self.version} if self.saved_to else {}
        return super().content() | where

    def _now(self) -> str:
        return f"; the twin at {self.saved_to} is now version {self.version}" if self.saved_to else ""


def measured_range(recording: Recording) -> tuple[float, float] | None:
    """Lowest and highest commanded pressure in kPa, 0 (vented) among them; None where nothing is driven.

    It ends where the supply does.
    """
    columns = recording.pressure_columns
    pressures = usable(recording)[0].samples[columns].to_numpy(float)
    if not pressures.size or not pressures.any():
        return None
    return 0.0 - _outwards(-min(pressures.min(), 0.0)), _outwards(max(pressures.max(), 0.0))


def range_sentence(pressure_range_kpa: tuple[float, float]) -> str:
    low, high = pressure_range_kpa
    return (
        f"The twin was measured from {low:g} to {high:g} kPa; robots and environments drive it no farther "
        "unless `pressure_range_kpa` is given."
    )


def _outwards(value: float) -> float:
    """The next number of two digits: valves and programs hardly ever stop at a round number."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit - 1e-6) * unit:.6g}")
