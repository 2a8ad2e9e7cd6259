"""The next program for the bench: what it separates, what it narrows, where it goes for the first time."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lerobot_pneutac.diagnosis.design import NO_HANDS, Choice, Limits, choices
from lerobot_pneutac.diagnosis.hands import Hands, instructions
from lerobot_pneutac.diagnosis.result import Candidate
from lerobot_pneutac.reports.design import design_page
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import called
from lerobot_pneutac.verbs.benches import save_program
from lerobot_pneutac.verbs.contenders import load_contenders
from lerobot_pneutac.verbs.diagnosis import Diagnosis
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.recording.chambers import per_chamber
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.pressures import usable
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

SHOWN = 8


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Design(Result):
    """Programs for the bench, the one that tells most for its time first.

    Attributes:
        twin: that was diagnosed.
        recording: that was diagnosed.
        contenders: models in the running.
        choices: see `lerobot_pneutac.diagnosis.design`.
        noise: floor of the error.
        unit: of it.
        hands: what could be changed.
    """

    twin: Twin
    recording: Recording
    contenders: tuple[Candidate, ...]
    choices: tuple[Choice, ...]
    noise: float
    unit: str
    hands: Hands = NO_HANDS

    title = "The next experiment"

    def subject(self) -> tuple[Twin, Path]:
        """The twin and the recording."""
        return self.twin, self.recording.folder

    @property
    def best(self) -> Choice:
        """The program to drive."""
        return self.choices[0]

    @property
    def sentence(self) -> str:
        """What to drive and what it will tell."""
        c = self.best
        if c.tells_little:
            return (
                "No program within these limits would show anything new; allow higher pressures or longer "
                "programs."
            )
        likely = self.contenders[0]
        first = "".join(f"{s} " for s in instructions(self.hands.usual, c.conditions))
        names = " + ".join(map(called, likely.terms)) or "no effect"
        best = f"{names} has {100 * likely.probability:.0f} %"
        gain = f"{c.rivals:.2f} nats between models, {c.constants:.1f} nats on constants"
        return (
            f"{first}Next, drive {c.name} ({c.seconds:.0f} s). Of {len(self.contenders)} candidate models "
            f"{best}; this test mainly {self._purpose}. Expected information: {gain}; "
            f"{100 * c.new:.0f} % of its time is where no recording has been."
        )

    @property
    def _purpose(self) -> str:
        decides = self.best.rivals >= max(np.log(len(self.contenders)) / 2, 1e-9)
        return "decides between them" if decides else "sharpens the constants of the first"

    def rows(self) -> list[dict]:
        """The best programs."""
        return [
            {
                "program": c.name,
                "s": f"{c.seconds:.0f}",
                "nats between models": f"{c.rivals:.2f}",
                "about constants": f"{c.constants:.1f}",
                "new, %": f"{100 * c.new:.0f}",
            }
            for c in self.choices[:SHOWN]
        ]

    def next_after(self, out: Path) -> str:
        """To drive it."""
        return shlex.join(["pneutac", "measure", f"--program={out}/program.csv", f"--out={out}/recording"])

    def to_dict(self) -> dict:
        """The content of `result.json`."""
        return {
            "program": self.best.name,
            "kind": self.best.kind,
            "hand": self.best.hand,
            "seconds": self.best.seconds,
            "nats_between_models": self.best.rivals,
            "nats_about_constants": self.best.constants,
            "share_where_nothing_was": self.best.new,
            "tells_little": self.best.tells_little,
            "contenders": [{"terms": list(c.terms), "probability": c.probability} for c in self.contenders],
            "sentence": self.sentence,
        }

    def report(self, out: str | Path, command: str = "") -> Path:
        """Writes `program.csv` too."""
        c = self.best
        save_program(Path(out) / "program.csv", c.time_s, c.pressure_kpa, c.kind, c.conditions)
        return super().report(out, command)

    def page(self) -> Report:
        """The program, and what each model predicts."""
        return design_page(self)


def design(
    twin: Twin,
    recording: Recording,
    diagnosis: str | Path | Diagnosis,
    max_kpa: float | Sequence[float] | None = None,
    min_kpa: float | Sequence[float] | None = None,
    budget_s: float = 600.0,
    program_s: float = 60.0,
    hz: float = 20.0,
    hands: Hands = NO_HANDS,
) -> Design:
    """Chooses the next program for a recording that was diagnosed.

    Args:
        twin: that was diagnosed.
        recording: likewise; everything that was measured so far.
        diagnosis: what `diagnose` found, itself or the folder that `pneutac diagnose --out=` wrote.
        max_kpa: highest set-point, one for all chambers or one for each; that of the recording where None.
        min_kpa: lowest one, likewise; that of the recording, at most 0, where None.
        budget_s: longest program.
        program_s: length of a program of the common kinds.
        hz: samples a second.
        hands: what may be changed for it.

    Raises:
        InputError: the folder holds no diagnosis of a body, or no program fits the limits.
    """
    if recording.device == "gel":
        raise InputError(f"{recording.folder} is of a gel; `design_press` chooses its next press.")
    found = isinstance(diagnosis, Diagnosis)
    contenders = list(diagnosis.outcome.contenders) if found else load_contenders(diagnosis)
    if not contenders:
        raise InputError("The diagnosis is of demonstrations; give one of a bench recording.")
    recording = usable(recording)[0]  # no program goes beyond the supply by itself
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    limits = Limits(
        per_chamber(
            "min_kpa", np.minimum(command.min(axis=0), 0.0) if min_kpa is None else min_kpa, len(command.T)
        ),
        per_chamber("max_kpa", command.max(axis=0) if max_kpa is None else max_kpa, len(command.T)),
        hz,
        budget_s,
        program_s,
    )
    noise = noise_floor(recording)
    ranked = choices(recording, contenders, noise.needed(recording.folder), limits, hands)
    return Design(
        twin=twin,
        recording=recording,
        contenders=tuple(contenders),
        choices=tuple(ranked),
        noise=noise.needed(recording.folder),
        unit=noise.unit,
        hands=hands,
    )
