"""Whether a gel sticks to what it presses: how its imprint turns while the arm drags the finger sideways.

A finger whose gel sticks is held at its tip: as the arm goes sideways the finger bends across and its tip
turns, by 3/2 of the way over its length however soft it is, and the imprint of a thing that is longer than
wide turns in the image. Where the gel slips the finger does not turn. Neither pressure, nor creep, nor
another stiffness does that. The twin's own finger bends in one plane, so nothing is replayed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np

from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.replay.imprint import rest_image, strengths, turns_deg
from pneutac_sim.features import ACTION_NAMES, EE

SIDEWAYS, DRAG_M_S = ACTION_NAMES.index("dy.vel"), 0.003  # of a command, and from which speed on it drags
LEAST_FRAMES, LEAST_MM = 30, 5.0  # of a drag in touch
SHOWN_LATE = 2  # frames by which images show a way late
LEAST = 3  # episodes
SLIPS = 0.5  # of the turn that was known
SURE = 2.0  # standard errors


@dataclass(frozen=True)
class Dragging:
    """How imprints turned where the finger was dragged.

    Attributes:
        turn_deg_per_mm: mean over episodes of the turn per way of the arm.
        error: its standard error.
        episodes: in which it was dragged.
    """

    turn_deg_per_mm: float
    error: float
    episodes: int

    @classmethod
    def of(cls, episodes: Sequence[Episode]) -> Self | None:
        """Of episodes; None where fewer than three drag the finger sideways in touch."""
        turns = np.array([t for t in map(turn_deg_per_mm, episodes) if t is not None])
        if len(turns) < LEAST:
            return None
        error = float(turns.std(ddof=1) / np.sqrt(len(turns)))
        return cls(float(turns.mean()), error, len(turns))

    @classmethod
    def known(cls, history: Sequence[Mapping], task: str) -> Self | None:
        """The last of a task that a twin's history has."""
        kept = [h["dragging"] for h in history if h.get("dragging", {}).get("task") == task]
        return cls(**kept[-1]["turn"]) if kept else None

    def slips(self, known: Self) -> bool:
        """Whether the gel, which stuck before, slips more now."""
        far = SURE * float(np.hypot(self.error, SLIPS * known.error))
        return self.turn_deg_per_mm + far < SLIPS * known.turn_deg_per_mm

    def less(self, known: Self) -> bool:
        far = SURE * float(np.hypot(self.error, known.error))
        return self.turn_deg_per_mm + far < known.turn_deg_per_mm

    def sentence(self, known: Self | None) -> str:
        """The finding about the gel's friction, a sentence."""
        told = (
            f"Dragged sideways, imprints turned by {self.turn_deg_per_mm:.2g} ({self.error:.1g}) degrees a mm"
        )
        if known is None:
            return f"{told}; `pneutac calibrate` stores that, to detect a change of the gel's friction."
        was = f"{known.turn_deg_per_mm:.2g} ({known.error:.1g}) before"
        if self.slips(known):
            return f"{told}, {was}: the gel has less friction than before and slips."
        if self.less(known):
            return f"{told}, {was}: the gel sticks less than before; by how much is not identifiable."
        return f"{told}, {was}: no loss of friction is significant."

    def kept(self, task: str) -> dict:
        """Entry for a twin's history."""
        return {"task": task, "turn": asdict(self)}


def turn_deg_per_mm(episode: Episode) -> float | None:
    """Least-squares turn of the imprint by the arm's way sideways; None where it is not dragged far."""
    contact = episode.contact()
    if contact is None:
        return None
    touched = slice(contact[0], contact[1] + 1)
    rows = np.abs(episode.action[touched, SIDEWAYS]) > DRAG_M_S
    way = 1e3 * episode.state[:, EE][np.maximum(np.arange(*touched.indices(len(episode))) - SHOWN_LATE, 0), 1]
    if rows.sum() < LEAST_FRAMES or np.ptp(way[rows]) < LEAST_MM:
        return None
    images, rest = episode.images[touched], rest_image(episode)
    turn, strong = turns_deg(images, rest), strengths(images, rest)
    rows &= np.isfinite(turn)
    if rows.sum() < LEAST_FRAMES:
        return None
    frames = np.arange(len(turn))
    ground = np.stack([way, np.ones(len(way)), frames], 1)[rows]  # it may turn slowly as it creeps
    weight = np.sqrt(strong[rows])
    return float(np.linalg.lstsq(ground * weight[:, None], turn[rows] * weight, rcond=None)[0][0])
