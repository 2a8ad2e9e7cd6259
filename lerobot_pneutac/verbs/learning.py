"""What the bench taught, round by round."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from lerobot_pneutac.diagnosis.thresholds import NOISE
from lerobot_pneutac.reports.learn import learn_page
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import called
from lerobot_pneutac.verbs.result import Result
from pneutac_sim.twin import Twin

KNOWN = ("adequate", "missing_effect")
CONFIRMS = 1.5  # error over noise, before it was used, up to which a recording confirms what predicted it
LEFT = 1.15  # error over noise, on all that was measured, above which something unknown is at work


@dataclass(frozen=True)
class Round:
    """One program and what it taught.

    Attributes:
        number: from 0.
        program: its name.
        kind: see `Choice`.
        seconds: of the program.
        pause_s: see `Bench`.
        unit: of the errors.
        noise: floor of the error.
        predicted_error: of this recording before it was used, by the best model then; None in the first.
        bare_error: the same by the twin as it was given, re-fitted.
        without: effect to the least such error without its kind of physics, by other models or by the best
            model without it, gain and offset fitted to favour it.
        error: on test blocks of everything measured so far, by the best model now.
        verdict: now.
        selected: effects found now, the most important first.
        sentence: what was found.
        probabilities: each candidate's among the others, its terms joined by ` + `.
        hand: what a hand had changed for it, see `hands.HANDS`; empty for nothing.
        needed_by: effect to the number of the round whose recording was predicted with it, and not without.
        confirmed_by: those of them found while the form sufficed and noise alone was left: else a law may
            stand in for another. A recording that `refutes` ends that.
        likely_right: see `Outcome`.
    """

    number: int
    program: str
    kind: str
    seconds: float
    pause_s: float | None
    unit: str
    noise: float
    predicted_error: float | None
    bare_error: float | None
    without: dict[str, float]
    error: float
    verdict: str
    selected: list[str]
    sentence: str
    probabilities: dict[str, float]
    hand: str = ""
    needed_by: dict[str, int] = field(default_factory=dict)
    confirmed_by: dict[str, int] = field(default_factory=dict)
    likely_right: float | None = None

    @property
    def suffices(self) -> bool:
        """Whether what was found explains everything measured so far."""
        return self.verdict in KNOWN and self.error <= LEFT * self.noise

    @property
    def foreseen(self) -> bool:
        """Whether this recording was predicted to the noise before it was used."""
        return self.predicted_error is not None and self.predicted_error <= NOISE * self.noise

    @property
    def refutes(self) -> bool:
        """Whether this recording was predicted badly, and nothing that was found then explains everything."""
        badly = self.predicted_error is not None and self.predicted_error > CONFIRMS * self.noise
        return badly and not self.suffices

    @property
    def unconfirmed(self) -> list[str]:
        """Effects found that no recording confirms."""
        return [e for e in self.selected if e not in self.confirmed_by]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Learning(Result):
    """What the bench taught, round by round.

    Attributes:
        twin: with all that was found; its folder has a version for each round.
        rounds: in order.
        ended: why there was no further round, a clause.
        folder: where everything lies.
    """

    twin: Twin
    rounds: tuple[Round, ...]
    ended: str
    folder: Path

    title = "Learnt from the bench"
    keys = (
        "confirmed", ("confirmed_by", "last.confirmed_by"), ("selected", "last.selected"),
        ("verdict", "last.verdict"), "ended", "bench_s", "sentence", "rounds",
    )  # fmt: skip

    @property
    def last(self) -> Round:
        return self.rounds[-1]

    @property
    def confirmed(self) -> bool:
        """Whether a recording of another kind, predicted before it was used, needed each effect found."""
        if not self.last.selected:
            return self.last.verdict == "adequate" and self.last.foreseen
        return self.last.verdict in KNOWN and not self.last.unconfirmed

    @property
    def bench_s(self) -> float:
        """Time on the bench."""
        return sum(r.seconds for r in self.rounds)

    @cached_property
    def sentence(self) -> str:
        """What is known now."""
        r = self.last
        minutes = f"{self.bench_s / 60:.1f} minutes on the bench in {len(self.rounds)} programs"
        if not r.selected:
            what = "nothing is missing" if self.confirmed else "nothing significant was found"
        else:
            names = [called(e) for e in r.selected]
            what = f"the {self.twin.device} shows " + (
                names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
            )
        foreseen = (
            f" The last program was predicted to {r.predicted_error:.3g} {r.unit} before it was used "
            f"({r.predicted_error / r.noise:.2g} times the noise)."
            if r.predicted_error is not None
            else ""
        )
        sure = [called(e) for e in r.selected if e in r.confirmed_by]
        loose = [called(e) for e in r.unconfirmed]
        status = (
            f" Confirmed, by a program of another kind that needed it: {', '.join(sure)}." if sure else ""
        )
        status += f" Not confirmed: {', '.join(loose)}." if loose else ""
        return f"After {minutes}: {what}.{foreseen}{status} It ended because {self.ended}."

    def rows(self) -> list[dict]:
        return [
            {
                "round": r.number,
                "program": r.program,
                "s": f"{r.seconds:.0f}",
                "foreseen": "" if r.predicted_error is None else f"{r.predicted_error:.3g}",
                "as given": "" if r.bare_error is None else f"{r.bare_error:.3g}",
                f"after, {r.unit}": f"{r.error:.3g}",
                "noise": f"{r.noise:.3g}",
                "found": ", ".join(f"{e}{'*' if e in r.confirmed_by else ''}" for e in r.selected) or "-",
                "right": "" if r.likely_right is None else f"{100 * r.likely_right:.0f} %",
                "verdict": r.verdict,
            }
            for r in self.rounds
        ]

    def remarks(self) -> list[str]:
        return [
            "right: share of test devices with a similar finding whose first-listed physics was right",
            "* confirmed: a recording of another kind was predicted with it before it was used",
            f"twin: {self.folder / 'twin'}, a version for each round",
        ]

    @property
    def next_command(self) -> str:
        """To see where the twin still fails, on the newest recording."""
        newest = self.folder / f"round_{self.last.number}" / "recording"
        return f"pneutac compare --twin={self.folder / 'twin'} --recording={newest}"

    def page(self) -> Report:
        """The error on each next recording before it was used, first."""
        return learn_page(self)
