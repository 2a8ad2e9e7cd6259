"""What the experts share: habits of a person, what the gel feels, and how to search a table by touch.

The commanded pressure is what an expert is doing, and it is part of the observation: vented, it withdraws;
at low pressure it searches; above, it acts on what it has found.
"""

from dataclasses import dataclass

import numpy as np

from pneutac_sim.world.world import World

TOUCH = 0.25  # mm of imprint, or N, that count as a touch, see `pressed`
VENTED_KPA, SEARCH_KPA = 1.5, 4.5  # below the first it withdraws, from there to the second it searches
FAST_M_S = 0.095
WRAP_M = 0.08  # how much farther up after the last lane
KEEP_HZ = 3.0  # how fast it corrects its lane
NEAR_M = 0.005  # heights that are told apart

Wish = tuple[np.ndarray, float]  # velocity (3,) m/s and pressure kPa


@dataclass
class Habits:
    """How one person acts in one episode, drawn anew each time.

    Attributes:
        speed: factor on all speeds.
        offset_m: error of the height at which it searches, metres.
        low_kpa, high_kpa: pressures of search and of manipulation.
        ramp_kpa_s: how fast the pressure is turned up.
        tremor: standard deviation of the velocity's noise, m/s.
    """

    speed: float
    offset_m: float
    low_kpa: float
    high_kpa: float
    ramp_kpa_s: float
    tremor: float = 0.003

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Habits":
        """A person's habits for one episode."""
        return cls(
            speed=rng.uniform(0.85, 1.15),
            offset_m=rng.uniform(-1, 1) * 0.0015,
            low_kpa=rng.uniform(2.75, 3.5),
            high_kpa=rng.uniform(11.0, 13.0),
            ramp_kpa_s=rng.uniform(8.0, 12.0),
        )


@dataclass(frozen=True)
class Lanes:
    """A search in lanes along x, from -y to +y, each begun at the near side.

    Attributes:
        height_m: of the gel while it looks for the object, metres above the table.
        rise_m: how far above that it withdraws.
        middles_m: y of the flange in each lane, ascending and evenly spaced.
        back_m: x of the flange at which a lane begins.
    """

    height_m: float
    rise_m: float
    middles_m: tuple[float, ...]
    back_m: float

    def ahead(self, world: World, habits: Habits, speed: float) -> np.ndarray:
        """Velocity (3,) along the lane, at the height of the search."""
        return go_ahead(world, habits, self.height_m, speed) + self.keep(world)

    def withdraw(self, world: World, end: bool) -> np.ndarray:
        """Velocity (3,) back to the near side: from the end of a lane above everything, else straight.

        On the way down to the next lane it moves on by one; after the last lane it goes up farther, and
        there back to before the first.

        Args:
            world: where it is.
            end: whether it is where a lane ends.
        """
        x, y, _ = world.flange_m
        rise, first, last = world.gel_m[2] - self.height_m, self.middles_m[0], self.middles_m[-1]
        width = self.middles_m[1] - first
        if x < self.back_m:
            if rise > self.rise_m + WRAP_M / 2 and y > first - 1.5 * width:
                return np.array([0.0, -FAST_M_S, KEEP_HZ * (self.rise_m + WRAP_M - rise)])
            # Between two heights, so that neither inertia nor latency makes the lane wider.
            aside = width / (self.rise_m - NEAR_M) if NEAR_M < rise < self.rise_m else 0.0
            return FAST_M_S * np.array([0.0, aside, -1.0]) / np.hypot(1.0, aside)
        if end and rise < self.rise_m + WRAP_M * (y > last - width / 2):
            return np.array([0.0, 0.0, FAST_M_S])
        return np.array([-FAST_M_S, 0.0, 0.0]) + self.keep(world)

    def begins(self, world: World) -> bool:
        """Whether it is where a lane begins."""
        return world.flange_m[0] < self.back_m and world.gel_m[2] < self.height_m + NEAR_M

    def keep(self, world: World) -> np.ndarray:
        """Velocity (3,) to the middle of the nearest lane."""
        away = np.subtract(self.middles_m, world.flange_m[1])
        return np.array([0.0, KEEP_HZ * away[np.argmin(np.abs(away))], 0.0])


def go_ahead(world: World, habits: Habits, height_m: float, speed: float) -> np.ndarray:
    """Velocity (3,) along x, with the gel at the height of the search."""
    up = height_m + habits.offset_m - world.gel_m[2]
    return speed * habits.speed * np.array([1.0, 0.0, np.clip(30 * up, -1, 1)])


def touching(world: World) -> bool:
    """Whether the gel shows a touch."""
    return pressed(world) > TOUCH


def pressed(world: World) -> float:
    """How hard the gel is pressed: its imprint in mm or the force on it in N, whichever is more.

    An edge makes a deep imprint with little force, a face hardly any with much; a person goes by both.
    """
    return max(world.press_mm, world.press_n)
