"""The next demonstrations: which motion of the arm, with the finger against a bar, shows what is open.

Every motion is simulated in the twin's own world as it is, and with one thing changed: creep, the finger's
stiffness, the gel's friction. Creep shows in the force's shape over time, stiffness in its level, friction in
how the imprint turns under a drag (its other traces are the chatter of a rigid contact). A change is told by
as many standard deviations as these differ relative to the error on demonstrations.

Pressures are those of the paper's finger; another's are as large a share of its range, as of an expert's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.thresholds import TELLS
from lerobot_pneutac.reports.figures import curves
from lerobot_pneutac.reports.page import Report, rows_of
from lerobot_pneutac.study.demonstration_fit import COMPLIANCE, STIFFNESS, TYPICAL, Strength
from lerobot_pneutac.study.demonstrations import UNIT
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.recording.wording import joined
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import CONTROL_HZ, PRESSURES
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.base import Variation
from pneutac_sim.world.expert import pressures_of
from pneutac_sim.world.soft_finger import GEL_FRICTION
from pneutac_sim.world.station import Station
from pneutac_sim.world.tasks.button import DRAG_M_S, HIGH_M
from pneutac_sim.world.world import World

TASK = "button"
SEARCH_KPA, LIGHT_KPA, PRESS_KPA, TOUCH_MM, LONGEST = 2.0, 4.0, 9.0, 0.3, 400
CHATTER = 3  # frames of a rigid contact, over which forces are averaged
LEFT_OUT_S = 1.0  # after the touch, in which the finger is filled


@dataclass(frozen=True, eq=False)
class Motion:
    """What the arm does once the finger touches."""

    name: str
    actions: np.ndarray  # (n, 4) flange's velocity m/s, paper finger's pressure kPa, at `CONTROL_HZ`
    drag_mm: float = 0.0  # how far it drags the finger sideways, to both sides

    @property
    def seconds(self) -> float:
        return len(self.actions) / CONTROL_HZ


@dataclass(frozen=True, eq=False)
class Response:
    """What happened in a motion, from a second after the touch on."""

    force_n: np.ndarray  # (T,) on the gel
    turn_deg: np.ndarray  # (T,) of the bar in the gel's frame
    sideways_mm: np.ndarray  # (T,) of the flange sideways

    @property
    def time_s(self) -> np.ndarray:
        return LEFT_OUT_S + np.arange(len(self.force_n)) / CONTROL_HZ

    @property
    def turn_deg_per_mm(self) -> float:
        """Least-squares turn by the way sideways; 0 where there is none."""
        path_mm = self.sideways_mm - self.sideways_mm.mean()
        return float(path_mm @ self.turn_deg / (path_mm @ path_mm)) if np.ptp(path_mm) > 1.0 else 0.0


def held(seconds: float, kpa: float = PRESS_KPA, velocity=(0.0, 0.0, 0.0)) -> list[np.ndarray]:
    return [np.array([*velocity, kpa])] * round(seconds * CONTROL_HZ)


def sideways(drag_mm: float, kpa: float = PRESS_KPA) -> Motion:
    """Holds, then drags to one side, the other, and back to the first."""
    there, v = 1e-3 * drag_mm / DRAG_M_S, DRAG_M_S
    actions = held(2, kpa) + held(there, kpa, (0, v, 0))
    actions += held(2 * there, kpa, (0, -v, 0)) + held(2 * there, kpa, (0, v, 0))
    how = "press" if kpa >= PRESS_KPA else "press lightly" if kpa > SEARCH_KPA else "just touch"
    return Motion(f"{how} and drag sideways by {drag_mm:g} mm", np.array(actions), drag_mm)


PRESS = Motion("press and hold", np.array(held(6)))
FORTH = held(1, velocity=(0, 0, 0.004)) + held(2, velocity=(0, 0, -0.004)) + held(2, velocity=(0, 0, 0.004))
STEPS = 3 * (held(0.5, velocity=(0.01, 0, 0)) + held(2))
MOTIONS = (
    PRESS,
    Motion("three steps of pressure, each held", np.array(held(2, 6.0) + held(2) + held(2, 12.0))),
    Motion("three steps of the arm, each held", np.array(held(2) + STEPS)),
    Motion("drag along the finger", np.array(held(2) + FORTH)),
)


def carried_out(world, seed: int, motion: Motion) -> Response:
    """What is felt in a motion once the finger has found the bar; raises InputError where it does not."""
    world.reset(seed)
    pressures: Callable[[float], np.ndarray] = pressures_of(world)
    for _ in range(LONGEST):
        if world.press_mm > TOUCH_MM:
            break
        up = np.clip(1.5 * (HIGH_M - world.gel_m[2]), -0.04, 0.04)
        world.step(np.array([0.04, 0.0, up, *pressures(SEARCH_KPA)]))
    else:
        raise InputError(f"The finger does not find the bar of '{TASK}' in this world; no motion was tried.")
    force, turn, path_mm = [], [], []
    for action in motion.actions:
        world.step(np.append(action[:3], pressures(float(action[PRESSURES][0]))))
        bar = world.data.site("gel").xmat.reshape(3, 3)[1]
        force.append(world.press_n)
        turn.append((np.degrees(np.arctan2(bar[1], bar[0])) + 90) % 180 - 90)
        path_mm.append(1e3 * world.flange_m[1])
    after = slice(round(LEFT_OUT_S * CONTROL_HZ), None)
    smooth = uniform_filter1d(np.array(force), CHATTER)
    return Response(smooth[after], np.array(turn)[after], np.array(path_mm)[after])


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
    """A motion, and how significantly it separates each change from all others."""

    motion: Motion
    significance: dict[str, float]  # of each change, standard deviations from what it could pass for
    responses: dict[str, Response]  # of every finger, by its name, at the first place


@dataclass(frozen=True)
class Misses:
    """By how much a set of demonstrations misses what it shows, standard deviations."""

    shape: float  # of the force, a share of it
    level: float  # of the logarithm of imprints' strength; infinite where none is known to hold it against
    turn: float  # degrees a mm

    @classmethod
    def of(cls, episodes: int, known_strength: bool) -> "Misses":
        """Of so many episodes; their errors are independent."""
        root = np.sqrt(episodes)
        return cls(SHAPE / root, LEVEL if known_strength else np.inf, TURN / root)

    def shaped(self, a: Response, b: Response) -> float:
        """Difference of two fingers in the shape of the force over one motion."""
        relative = a.force_n / a.force_n.mean() - b.force_n / b.force_n.mean()
        return float(np.sqrt(np.mean(np.square(relative))) / self.shape)

    def levelled(self, a: Response, b: Response) -> float:
        return abs(float(TYPICAL * np.log(a.force_n.mean() / b.force_n.mean()) / self.level))

    def turned(self, a: Response, b: Response) -> float:
        return abs(a.turn_deg_per_mm - b.turn_deg_per_mm) / self.turn


def motion_choices(
    twin: Twin,
    misses: Misses,
    station: Station | None = None,
    progress: Progress = no_progress,
) -> list[MotionChoice]:
    """Every motion, and what it would show."""
    motions = (*MOTIONS, *(sideways(*drag) for drag in DRAGS))
    responses: dict[str, list[list[Response]]] = {}
    changes, done = fingers(twin), 0
    for name, (changed, friction) in changes.items():
        world = World(TASK, changed, "none", station=station, sideways=True)
        world.variation = Variation(friction=friction)
        responses[name] = []
        for motion in motions:
            responses[name].append([carried_out(world, seed, motion) for seed in PLACES])
            done += 1
            progress("motions", done, len(changes) * len(motions))
    out = []
    for i, m in enumerate(motions):
        here = {name: each[i] for name, each in responses.items()}

        def mean(difference: Callable[[Response, Response], float], a: str, b: str, here=here) -> float:
            return float(np.mean([difference(x, y) for x, y in zip(here[a], here[b], strict=True)]))

        shape, level = (mean(d, CREEP, COMPLIANCE) for d in (misses.shaped, misses.levelled))
        confusable = float(np.hypot(shape, level))
        significance = {
            CREEP: min(mean(misses.shaped, CREEP, PLAIN), confusable),
            COMPLIANCE: min(mean(misses.levelled, COMPLIANCE, PLAIN), confusable),
            FRICTION: mean(misses.turned, FRICTION, PLAIN),
        }
        out.append(MotionChoice(m, significance, {name: each[0] for name, each in here.items()}))
    return out


def shortest(choices: Sequence[MotionChoice], change: str) -> MotionChoice:
    """The shortest motion that significantly shows a change, else the one that shows it best."""
    significant = [c for c in choices if c.significance[change] >= T.TELLS]
    if significant:
        return min(significant, key=lambda c: c.motion.seconds)
    return max(choices, key=lambda c: c.significance[change])


def fingers(twin: Twin) -> dict[str, tuple[Twin, float]]:
    """The twin as it is and with one change, and the factor on the friction of its gel."""
    softer = twin.copy()
    softer.parameters = twin.parameters | {STIFFNESS: Value(SOFTER * twin.parameter(STIFFNESS))}
    creeping, own = twin.copy(), twin.effects.get(CREEP)  # else of its usual amount
    more = {
        p.name: Value(MORE_CREEP * own[p.name].value if own else p.default)
        for p in get_effect(CREEP).parameters
    }
    creeping.effects = twin.effects | {CREEP: more}
    return {PLAIN: (twin, 1.0), CREEP: (creeping, 1.0), COMPLIANCE: (softer, 1.0), FRICTION: (twin, SLIPPERY)}


WORDS = {CREEP: "more creep", COMPLIANCE: "another stiffness", FRICTION: "half the friction of the gel"}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MotionDesign(Result):
    """Motions of the arm, and how significantly each shows which change."""

    twin: Twin
    recording: Demonstrations
    choices: tuple[MotionChoice, ...]
    known: bool  # whether the twin knows how strong imprints are

    heading = "The next demonstrations"
    caption = "Standard deviations with which each motion would show a change."
    keys = (("imprints_known", "known"), "sentence")

    @property
    def chosen(self) -> dict[str, MotionChoice]:
        """For each change the shortest motion that significantly shows it; without those that none shows."""
        best = {change: shortest(self.choices, change) for change in WORDS}
        return {change: c for change, c in best.items() if c.significance[change] >= TELLS}

    @property
    def sentence(self) -> str:
        motions: dict[str, list[str]] = {}
        for change, c in self.chosen.items():
            changes = motions.setdefault(f"{c.motion.name} ({c.motion.seconds:.0f} s)", [])
            changes.append(f"{WORDS[change]} ({c.significance[change]:.1f} standard deviations)")
        if not motions:
            none = "None of these motions would significantly show creep, stiffness or friction"
            return f"{none}; record more episodes."
        listed = "; ".join(f"{name}, which shows {joined(changes)}" for name, changes in motions.items())
        count = len(self.recording.episodes)
        return f"Record {count} episodes with the finger against the bar of '{TASK}': {listed}."

    def rows(self) -> list[dict]:
        columns = {"motion": "motion.name", "s": "{0.motion.seconds:.0f}"}
        columns |= {words: f"{{0.significance[{change}]:.1f}}" for change, words in WORDS.items()}
        return rows_of(self.choices, columns)

    def remarks(self) -> list[str]:
        out = []
        if not self.known:
            why = f"The twin was fitted to no demonstrations of '{TASK}', so imprints' strength is unknown"
            out.append(f"{why}, and no motion shows another stiffness by imprints. Add ten plain ones first.")
        for change in (change for change in WORDS if change not in self.chosen):
            best = shortest(self.choices, change)
            by = f"{best.motion.name} does best, by {best.significance[change]:.1f} standard deviations"
            out.append(f"No motion significantly shows {WORDS[change]}: {by}.")
        out.append(
            f"The gel's friction is taken as {GEL_FRICTION:g}, and the finger as stiff sideways as in its "
            "plane. A drag shows less friction only in comparison with earlier drags of the same kind, "
            "which `pneutac calibrate` stores."
        )
        return out

    def content(self) -> dict:
        columns = {"name": "motion.name", "seconds": "motion.seconds", "standard_deviations": "significance"}
        motions = rows_of(self.choices, columns)
        out = super().content() | {"episodes": len(self.recording.episodes), "motions": motions}
        return out | {"chosen": {change: c.motion.name for change, c in self.chosen.items()}}

    def page(self) -> Report:
        page = super().page()
        for c in dict.fromkeys(self.chosen.values()):
            titles, x, y = ("time, s", "force on the gel, N"), "time_s", "force_n"
            if c.motion.drag_mm > 0:
                titles = ("sideways path of the arm, mm", "turn of the imprint, degrees")
                x, y = "sideways_mm", "turn_deg"
            lines = ((name, getattr(r, x), getattr(r, y), None) for name, r in c.responses.items())
            changed = f"{c.motion.name}: the twin as it is, and with one thing changed.".capitalize()
            page.figure(curves(lines, *titles), changed)
        return page


def design_motion(twin: Twin, recording: Demonstrations, progress: Progress = no_progress) -> MotionDesign:
    """Chooses the motions to demonstrate next.

    Args:
        twin: of a finger of one chamber, simulated as it is and with one change at a time.
        recording: demonstrations, as many as would be recorded, in whose station.
        progress: called with how many motions have been simulated.

    Raises InputError: the twin has several chambers, or its finger does not find the bar there.
    """
    last = ([{}] + [h for h in twin.history if h.get("unit") == UNIT])[-1]
    known = Strength.known(last, TASK) is not None
    misses = Misses.of(len(recording.episodes), known)
    choices = motion_choices(twin, misses, recording.station, progress)
    return MotionDesign(twin=twin, recording=recording, choices=tuple(choices), known=known)
