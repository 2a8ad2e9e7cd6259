"""The domain randomisation of one new demonstration."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pneutac_sim.finger.confidence import Z95
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import Variation
from pneutac_sim.world.checks import Conditions, draw

# Standard deviations.
FRICTION = 0.15  # of the factor on the gel's friction
PEAK_KPA = 0.5  # of the peak pressure of a finger of 0 to 15 kPa; of another in proportion to its range
BEND_GAIN = 0.04  # of the factor on pressure to bend, at most, and where the twin has no interval of its own
ASIDE_M = 0.005  # of the object's place along y, at most: the way there stays, and a gel is 16 mm wide
LATE = 1  # control steps by which touch is shown too late, at most


@dataclass(frozen=True)
class Variant:
    """One draw of the domain randomisation."""

    source: int  # index of the reference
    # (3,) displacement of the object and, from the touch on, of the reference trajectory; its height stays,
    # as objects stand on the table. Until the touch the trajectory stays: nothing else shows where the object
    # is.
    shift_m: tuple[float, float, float]
    friction: float  # factor on the gel's friction
    peak_kpa: float  # added to the peak pressure, and in proportion below it
    bend_gain: float  # factor on pressure to bend
    late_commands: int = 0  # control steps by which commands act too late, as they did in the demonstrations
    late_touch: int = 0  # control steps by which touch is shown too late, which is not recorded
    conditions: dict[str, float] = field(default_factory=dict)  # of the world

    @classmethod
    def draw(
        cls,
        source: int,
        sigma_m: np.ndarray,
        late_commands: int,
        rng: np.random.Generator,
        conditions: Conditions | None = None,
        bend_gain_sd: float = BEND_GAIN,
    ) -> "Variant":
        """A variant of a reference; factors stay within two standard deviations."""
        friction, peak, gain = np.clip(rng.standard_normal(3), -2, 2)
        sigma_m = np.array([sigma_m[0], min(sigma_m[1], ASIDE_M), 0.0])
        shift = np.clip(rng.standard_normal(3), -2, 2) * sigma_m
        return cls(
            source,
            tuple(shift.tolist()),
            float(1 + FRICTION * friction),
            float(PEAK_KPA * peak),
            float(1 + bend_gain_sd * gain),
            late_commands,
            int(rng.integers(0, LATE + 1)),
            draw(conditions or {}, rng),
        )

    def of_world(self, start_m: np.ndarray, shift_m: Sequence[float] = (0.0, 0.0, 0.0)) -> Variation:
        """The world's own: the flange starts at `start_m` (3,), objects stand `shift_m` (3,) aside, m."""
        start, shift = tuple(np.asarray(start_m).tolist()), tuple(np.add(shift_m, self.shift_m).tolist())
        late = self.late_commands, self.late_touch
        return Variation(start, shift, self.bend_gain, self.friction, *late, self.conditions)


def bend_gain_sd(twin: Twin | None) -> float:
    """Standard deviation of the factor on pressure to bend: by the interval of the twin's own gain.

    Where gain and rest pressure can stand in for each other that interval may even include zero, though they
    fix the bend together; it is then no measure of how far the bend may be off.
    """
    gain = twin.parameters.get("gain_rad_per_kpa") if twin else None
    if gain is None or gain.ci95 is None or not gain.value:
        return BEND_GAIN
    return min((gain.ci95[1] - gain.ci95[0]) / (2 * Z95 * abs(gain.value)), BEND_GAIN)
