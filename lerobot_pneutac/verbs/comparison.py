"""The result of a comparison of a twin with a recording; by device in `compare_body` and `compare_gel`."""

from abc import abstractmethod
from pathlib import Path

import numpy as np

from lerobot_pneutac.verbs.result import Result, command_on
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.twin import Twin


class Comparison(Result):
    """A twin against a recording.

    Attributes:
        twin: that was compared.
        unit: of the errors.
        noise_floor: error that the measurement's own noise makes; None where it is unknown.
    """

    twin: Twin
    unit: str
    noise_floor: float | None

    @property
    @abstractmethod
    def error(self) -> dict[str, float | None]:
        """Root mean square error by part, `train` and `heldout` among them; None where a part is empty."""

    @property
    @abstractmethod
    def by(self) -> dict[str, list[dict]]:
        """Under which conditions it fails: axis to one row a bin."""

    @property
    @abstractmethod
    def worst(self) -> list[dict]:
        """Where it fails most."""

    @property
    def history(self) -> list[dict]:
        """How the error of the twin's versions fell."""
        names = ("version", "change", "train", "heldout", "unit")
        return [{k: e.get(k) for k in names} for e in self.twin.history]

    @property
    def next_command(self) -> str:
        """To learn why it fails, on a recording that the twin was fitted to.

        A recording that it was never fitted to tests it, and would no longer once it is diagnosed.
        """
        fitted = [Path(e["recording"]) for e in self.twin.history if e.get("recording")]
        here = Path(self.subject()[1])
        if not fitted or here.resolve() in [p.resolve() for p in fitted]:
            return command_on("diagnose", self.twin, here)
        return command_on("diagnose", self.twin, fitted[-1])

    @property
    def heldout(self) -> float | None:
        """Error where the twin was not fitted."""
        return self.error["heldout"]

    @property
    def train(self) -> float | None:
        """Error where the twin was fitted."""
        return self.error["train"]


def rms_of(squared: np.ndarray) -> float | None:
    """Root of the mean of squares (n,); None where there is none."""
    return root_mean(squared) if len(squared) else None
