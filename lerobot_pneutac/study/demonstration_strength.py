"""How hard the finger presses, by how strong its imprints are beside those that its twin was fitted to.

A finger that is softer than its twin, and bent as far by its air, presses with less force by one factor,
whatever arm and air do: over time, over the arm's advance and over pressure all forces fall alike. So no
motion tells it, and an episode's imprints by themselves do not: where the gel is pressed decides how strong
they are. But the median of many episodes hardly differs from one day to another: a twin that was fitted to
demonstrations of a task keeps it, and others of that task are held against it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np

from lerobot_pneutac.study.demonstration_touch import TYPICAL
from pneutac_sim.twin import Twin, Value

COMPLIANCE = "compliance"
STIFFNESS = "joint_stiffness_nm_per_rad"
ALIKE = 0.2  # logarithm of levels by which others of the same finger differ
SURE = 2.0  # standard errors
MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
MEDIAN = 1.2533  # standard error of a median over that of a mean
FAINTEST = 1e-6  # levels


@dataclass(frozen=True)
class Strength:
    """How strong the imprints of some episodes are.

    Attributes:
        log_gain: median over episodes of the logarithm of levels/N^growth.
        error: its standard error.
        growth: power of the force with which the imprints were taken to grow.
        stiffness: of the twin's joints that made the forces, N m/rad.
        light: brightness of the gel at rest, of red, green and blue, levels.
    """

    log_gain: float
    error: float
    growth: float
    stiffness: float
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @classmethod
    def of(cls, gains: np.ndarray, growth: float, twin: Twin) -> Self:
        """Of the gains (episodes,) that a model found, by whatever light."""
        logs = np.log(np.maximum(gains, FAINTEST))
        spread = MAD * float(np.median(np.abs(logs - np.median(logs))))
        error = float(MEDIAN * spread / np.sqrt(len(logs)))
        return cls(float(np.median(logs)), error, growth, twin.parameter(STIFFNESS))

    @classmethod
    def known(cls, history: Mapping, task: str) -> Self | None:
        """As a twin's history has it; None where it was fitted to no demonstrations of this task."""
        kept = history.get("imprint", {})
        if kept.get("task") != task:
            return None
        return cls(**kept["strength"] | {"light": tuple(kept["strength"]["light"])})

    def kept(self, task: str, light: Iterable[float]) -> dict:
        """As a twin's history keeps it, with the light (3,) by which it was told, levels."""
        return {"task": task, "strength": asdict(self) | {"light": [float(x) for x in light]}}

    def apart(self, known: Self) -> float:
        """Logarithm of how much stronger imprints are than was known; 0 where one finger's differ by that.

        By another stiffness all forces differ, and imprints by the power `TYPICAL` of that.
        """
        expected = known.log_gain + (TYPICAL - known.growth) * np.log(self.stiffness / known.stiffness)
        apart = float(self.log_gain - expected)
        return apart if abs(apart) > max(ALIKE, SURE * self.off(known)) else 0.0

    def off(self, known: Self) -> float:
        """Standard error of that."""
        return float(np.hypot(self.error, known.error))

    def pressing(self, twin: Twin, known: Self) -> Twin:
        """The twin, whose finger presses as hard as imprints are strong."""
        share, wide = np.exp(self.apart(known) / TYPICAL), np.exp(2 * self.off(known) / TYPICAL)
        out, whole = twin.copy(), float(share * twin.parameter(STIFFNESS))
        out.parameters = out.parameters | {STIFFNESS: Value(whole, (whole / wide, whole * wide))}
        return out
