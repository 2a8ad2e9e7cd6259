"""The next press for a gel: what it separates."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from lerobot_pneutac.diagnosis.result import Candidate
from lerobot_pneutac.diagnosis.thresholds import LITTLE_GAIN
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.study.gel_press import HeldChoice, PressChoice, held_choice, press_choices
from lerobot_pneutac.study.pair import same_device
from lerobot_pneutac.verbs.diagnosis import Diagnosis, described, load_contenders, named_terms
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.files import whole
from pneutac_sim.gel.indenter import Press
from pneutac_sim.twin import Twin

SHOWN = 8


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PressDesign(Result):
    """Presses for a gel, the most informative first.

    Attributes:
        twin: that was diagnosed.
        recording: that was diagnosed.
        contenders: candidate models.
        choices: see `lerobot_pneutac.study.gel_press`.
        held: the two presses with the most information on creep, see `lerobot_pneutac.study.gel_press`.
    """

    twin: Twin
    recording: Recording
    contenders: tuple[Candidate, ...]
    choices: tuple[PressChoice, ...]
    held: HeldChoice

    title = "The next press"
    keys = (("nats_between_models", "best.rivals"), "tells_little", "sentence")

    @property
    def best(self) -> PressChoice:
        return self.choices[0]

    @property
    def tells_little(self) -> bool:
        return self.best.rivals < LITTLE_GAIN

    @property
    def held_first(self) -> bool:
        """Whether a candidate model has creep, and two presses show more of it than any one."""
        return not self.held.assumed and self.held.rivals > max(self.best.rivals, LITTLE_GAIN)

    @property
    def sentence(self) -> str:
        if self.held_first:
            return self.held.sentence
        if self.tells_little:
            return (
                "No press of these indenters would distinguish the candidate models; press another shape, "
                "such as an edge or a small cylinder, and diagnose again."
            )
        p, likely = self.best.press, self.contenders[0]
        return (
            f"Press the {p.indenter} of {p.size_mm:g} mm {p.depth_mm:g} mm deep at x {p.x_mm:g}, "
            f"y {p.y_mm:g} mm: {self.best.rivals:.2f} nats between {len(self.contenders)} models, of which "
            f"{named_terms(likely)} is the likeliest ({100 * likely.probability:.0f} %)."
        )

    def rows(self) -> list[dict]:
        return [
            {
                "indenter": f"{c.press.indenter}, {c.press.size_mm:g} mm",
                "x, mm": f"{c.press.x_mm:g}",
                "y, mm": f"{c.press.y_mm:g}",
                "depth, mm": f"{c.press.depth_mm:g}",
                "nats between models": f"{c.rivals:.2f}",
            }
            for c in self.choices[:SHOWN]
        ]

    def remarks(self) -> list[str]:
        return [] if self.held_first else [self.held.sentence]

    def content(self) -> dict:
        held = self.held
        creep = {"presses": self._held_rows(), "wait_s": held.wait_s, "share_left": held.share}
        creep |= {"levels": held.levels, "nats": held.rivals, "assumed": held.assumed}
        return super().content() | {
            "press": _row(self.best.press),
            "creep": creep | {"first": self.held_first},
            "contenders": described(self.contenders),
        }

    def _held_rows(self) -> list[dict]:
        return [_row(p) | {"time_s": t, "hold_s": hold} for p, t, hold in self.held.rows()]

    def report(self, out: str | Path, command: str = "") -> Path:
        """Writes `press.csv` too, a row a press as a gel's recording has it."""
        with whole(Path(out) / "press.csv") as part:
            rows = self._held_rows() if self.held_first else [_row(self.best.press)]
            pd.DataFrame(rows).to_csv(part, index=False)
        return super().report(out, command)

    def page(self) -> Report:
        page, images = super().page(), self.best.images
        names = [f"{100 * c.probability:.0f} % {named_terms(c)}" for c in self.contenders]
        page.image(np.concatenate(images, axis=1), f"What each model predicts: {', '.join(names)}.")
        first = images[0].astype(float)
        apart = [np.clip(128 + 4 * (i - first), 0, 255).astype(np.uint8) for i in images[1:]]
        if apart:
            page.image(np.concatenate(apart, axis=1), "The others less the first, four times exaggerated.")
        return page


def design_press(twin: Twin, recording: Recording, diagnosis: str | Path | Diagnosis) -> PressDesign:
    """Chooses the next press for a gel's recording that was diagnosed.

    Args:
        twin: that was diagnosed.
        recording: likewise; all photographs so far.
        diagnosis: what `diagnose` found, itself or the folder that `pneutac diagnose --out=` wrote.

    Raises:
        InputError: the recording is of no gel, the folder holds no diagnosis, or one of a body.
    """
    same_device(twin, recording, "the twin", "design for")
    contenders = load_contenders(diagnosis)
    data = GelRecording.load(recording)
    return PressDesign(
        twin=twin,
        recording=recording,
        contenders=tuple(contenders),
        choices=tuple(press_choices(data, contenders)),
        held=held_choice(data, contenders),
    )


def _row(p: Press) -> dict:
    size = "indenter_size_mm" if p.indenter in ("cube", "edge") else "indenter_radius_mm"
    return {"indenter": p.indenter, size: p.size_mm, "x_mm": p.x_mm, "y_mm": p.y_mm, "depth_mm": p.depth_mm}
