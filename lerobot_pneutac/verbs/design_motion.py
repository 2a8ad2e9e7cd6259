"""The next demonstrations: which motion of the arm, with the finger against a bar, shows what is open."""

from collections.abc import Iterable
from dataclasses import dataclass

from lerobot_pneutac.diagnosis.thresholds import TELLS
from lerobot_pneutac.reports.design import motion_page
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.study.demonstration_data import COMPLIANCE, Strength
from lerobot_pneutac.study.demonstration_motions import (
    CREEP,
    FRICTION,
    Misses,
    MotionChoice,
    motion_choices,
    shortest,
)
from lerobot_pneutac.study.demonstrations import UNIT
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.demonstrations.motions import TASK
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin
from pneutac_sim.world.soft_finger import GEL_FRICTION

WORDS = {CREEP: "more creep", COMPLIANCE: "another stiffness", FRICTION: "half the friction of the gel"}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MotionDesign(Result):
    """Motions of the arm, and how significantly each shows which change.

    Attributes:
        twin: in whose world they were simulated.
        recording: the demonstrations that there are.
        choices: see `lerobot_pneutac.study.demonstration_motions`.
        known: whether the twin knows how strong imprints are.
    """

    twin: Twin
    recording: Demonstrations
    choices: tuple[MotionChoice, ...]
    known: bool

    title = "The next demonstrations"
    keys = (("imprints_known", "known"), "sentence")

    @property
    def chosen(self) -> dict[str, MotionChoice]:
        """For each change the shortest motion that significantly shows it; without those that none shows."""
        best = {change: shortest(self.choices, change) for change in WORDS}
        return {change: c for change, c in best.items() if c.sure[change] >= TELLS}

    @property
    def sentence(self) -> str:
        """Which motions to record and what they show."""
        motions: dict[str, list[str]] = {}
        for change, c in self.chosen.items():
            changes = motions.setdefault(f"{c.motion.name} ({c.motion.seconds:.0f} s)", [])
            changes.append(f"{WORDS[change]} ({c.sure[change]:.1f} standard deviations)")
        if not motions:
            return (
                "None of these motions would significantly show creep, stiffness or friction; record more "
                "episodes."
            )
        tell = "; ".join(f"{name}, which shows {_listed(changes)}" for name, changes in motions.items())
        count = len(self.recording.episodes)
        return f"Record {count} episodes with the finger against the bar of '{TASK}': {tell}."

    def rows(self) -> list[dict]:
        """Every motion, and the standard deviations by which it shows each change."""
        return [
            {
                "motion": c.motion.name,
                "s": f"{c.motion.seconds:.0f}",
                **{WORDS[change]: f"{c.sure[change]:.1f}" for change in WORDS},
            }
            for c in self.choices
        ]

    def remarks(self) -> list[str]:
        out = []
        if not self.known:
            out.append(
                f"The twin was fitted to no demonstrations of '{TASK}', so how strong its imprints are is "
                f"not known, and no motion shows another stiffness by that. Add ten plain ones first."
            )
        for change in WORDS:
            best = shortest(self.choices, change)
            if change not in self.chosen:
                out.append(
                    f"No motion significantly shows {WORDS[change]}: {best.motion.name} does best, by "
                    f"{best.sure[change]:.1f} standard deviations."
                )
        out.append(
            f"The gel's friction is taken as {GEL_FRICTION:g}, and the finger as stiff sideways as in its "
            "plane. A drag shows less friction only in comparison with earlier drags of the same kind, "
            "which `pneutac calibrate` stores."
        )
        return out

    def content(self) -> dict:
        return super().content() | {
            "episodes": len(self.recording.episodes),
            "motions": [
                {"name": c.motion.name, "seconds": c.motion.seconds, "standard_deviations": c.sure}
                for c in self.choices
            ],
            "chosen": {change: c.motion.name for change, c in self.chosen.items()},
        }

    def page(self) -> Report:
        """The motions, and what each finger would show of them."""
        return motion_page(self)


def design_motion(twin: Twin, recording: Demonstrations, progress: Progress = no_progress) -> MotionDesign:
    """Chooses the motions to demonstrate next.

    Args:
        twin: of a finger of one chamber, simulated as it is and with one change at a time.
        recording: demonstrations, as many as would be recorded, in whose station.
        progress: called with how many motions have been simulated.

    Raises:
        InputError: the twin has several chambers, or its finger does not find the bar there.
    """
    last = ([{}] + [h for h in twin.history if h.get("unit") == UNIT])[-1]
    known = Strength.known(last, TASK) is not None
    misses = Misses.of(len(recording.episodes), known)
    choices = motion_choices(twin, misses, recording.station, progress)
    return MotionDesign(twin=twin, recording=recording, choices=tuple(choices), known=known)


def _listed(words: Iterable[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
