"""Which motion of the arm, with the finger against a bar, shows what demonstrations leave open.

Every motion is simulated in the twin's own world as it is, and with one thing changed: creep, the finger's
stiffness, the gel's friction. Creep shows in the force's shape over time, stiffness in its level, friction in
how the imprint turns under a drag (its other traces are the chatter of a rigid contact). A change is told by
as many standard deviations as these differ relative to the error on demonstrations.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.study.demonstration_data import COMPLIANCE, STIFFNESS, TYPICAL
from pneutac_datasets.demonstrations.motions import (
    LIGHT_KPA,
    MOTIONS,
    PRESS_KPA,
    SEARCH_KPA,
    TASK,
    Felt,
    Motion,
    carried_out,
    sideways,
)
from pneutac_sim.effects import get_effect
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.station import Station
from pneutac_sim.world.varied import SidewaysWorld, Variation

PLAIN, CREEP, FRICTION = "as it is", "creep", "gel friction"
MORE_CREEP, SOFTER, SLIPPERY = 2.5, 0.7, 0.5  # what is changed, by which factor
DRAGS = ((12.0, PRESS_KPA), (20.0, PRESS_KPA), (20.0, LIGHT_KPA), (20.0, SEARCH_KPA))  # mm, kPa
PLACES = (3, 4)  # seeds of the scene
# What demonstrations of the stand-in miss by: the shape of a hold's force, as a share of it, of an episode;
# the logarithm of imprints' strength, of a set; the turn under a drag, degrees a mm, of an episode. See
# benchmarks/demonstrations.md.
SHAPE, LEVEL, TURN = 0.013, T.STRENGTH_DIFFERS / T.STRENGTH_ERRORS, 0.19


@dataclass(frozen=True, eq=False)
class MotionChoice:
    """A motion, and how significantly it separates each change from all others.

    Attributes:
        motion: of the arm.
        sure: of `creep`, `compliance` and `gel friction`, standard deviations from what it could pass for.
        felt: of every finger, by its name, at the first place.
    """

    motion: Motion
    sure: dict[str, float]
    felt: dict[str, Felt]


@dataclass(frozen=True)
class Misses:
    """By how much a set of demonstrations misses what it shows, standard deviations.

    Attributes:
        shape: of the force, a share of it.
        level: of the logarithm of imprints' strength; infinite where none is known to hold it against.
        turn: degrees a mm.
    """

    shape: float
    level: float
    turn: float

    @classmethod
    def of(cls, episodes: int, known_strength: bool) -> "Misses":
        """Of so many episodes; their errors are independent."""
        root = np.sqrt(episodes)
        return cls(SHAPE / root, LEVEL if known_strength else np.inf, TURN / root)

    def shaped(self, a: Felt, b: Felt) -> float:
        """Difference of two fingers in the shape of the force over one motion."""
        relative = a.force_n / a.force_n.mean() - b.force_n / b.force_n.mean()
        return float(np.sqrt(np.mean(np.square(relative))) / self.shape)

    def levelled(self, a: Felt, b: Felt) -> float:
        return abs(float(TYPICAL * np.log(a.force_n.mean() / b.force_n.mean()) / self.level))

    def turned(self, a: Felt, b: Felt) -> float:
        return abs(a.turn_deg_per_mm - b.turn_deg_per_mm) / self.turn


def motion_choices(
    twin: Twin,
    misses: Misses,
    station: Station | None = None,
    progress: Progress = no_progress,
    drags: Sequence[tuple[float, float]] = DRAGS,
) -> list[MotionChoice]:
    """Every motion, and what it would show; none is written anywhere.

    Args:
        twin: of a finger of one chamber.
        misses: of the demonstrations that would be recorded.
        station: where.
        progress: called with how many motions of all fingers have been simulated.
        drags: how far to drag sideways, mm, pressing with what of the paper's finger, kPa.

    Raises:
        InputError: the twin has several chambers, or its finger does not find the bar.
    """
    motions = (*MOTIONS, *(sideways(*drag) for drag in drags))
    felt: dict[str, list[list[Felt]]] = {}
    changes, done = fingers(twin), 0
    for name, (changed, friction) in changes.items():
        world = SidewaysWorld(TASK, changed, "none", station=station)
        world.variation = Variation(friction=friction)
        felt[name] = []
        for motion in motions:
            felt[name].append([carried_out(world, seed, motion) for seed in PLACES])
            done += 1
            progress("motions", done, len(changes) * len(motions))
    return [
        MotionChoice(
            m, _sure(misses, {n: f[i] for n, f in felt.items()}), {n: f[i][0] for n, f in felt.items()}
        )
        for i, m in enumerate(motions)
    ]


def shortest(choices: Sequence[MotionChoice], change: str) -> MotionChoice:
    """The shortest motion that significantly shows a change, else the one that shows it best."""
    told = [c for c in choices if c.sure[change] >= T.TELLS]
    if told:
        return min(told, key=lambda c: c.motion.seconds)
    return max(choices, key=lambda c: c.sure[change])


def _sure(misses: Misses, felt: Mapping[str, list[Felt]]) -> dict[str, float]:
    def mean(apart: Callable[[Felt, Felt], float], a: str, b: str) -> float:
        return float(np.mean([apart(x, y) for x, y in zip(felt[a], felt[b], strict=True)]))

    alike = np.hypot(mean(misses.shaped, CREEP, COMPLIANCE), mean(misses.levelled, CREEP, COMPLIANCE))
    return {
        CREEP: min(mean(misses.shaped, CREEP, PLAIN), float(alike)),
        COMPLIANCE: min(mean(misses.levelled, COMPLIANCE, PLAIN), float(alike)),
        FRICTION: mean(misses.turned, FRICTION, PLAIN),
    }


def fingers(twin: Twin) -> dict[str, tuple[Twin, float]]:
    """The twin as it is and with one change, and the factor on the friction of its gel."""
    softer = twin.copy()
    softer.parameters = twin.parameters | {STIFFNESS: Value(SOFTER * twin.parameter(STIFFNESS))}
    return {
        PLAIN: (twin, 1.0),
        CREEP: (_creeping(twin), 1.0),
        COMPLIANCE: (softer, 1.0),
        FRICTION: (twin, SLIPPERY),
    }


def _creeping(twin: Twin) -> Twin:
    """With more of the creep that it has, or with creep's usual amount where it has none."""
    own = twin.effects.get(CREEP)
    more = {
        p.name: Value(MORE_CREEP * own[p.name].value if own else p.default)
        for p in get_effect(CREEP).parameters
    }
    out = twin.copy()
    out.effects = twin.effects | {CREEP: more}
    return out
