"""Labels without a person's delay: who answers a touch late teaches a policy to answer late, too.

A person moves 0.2 to 0.4 s after the touch that is answered. A policy need not wait: its label in touch is
what was done that much later. `pneutac augment` finds the delay and writes it into its dataset.
"""

import numpy as np

from pneutac_sim.features import SPECKS

ANSWER_DELAY = "answer_delay_frames"  # in the `info` of a dataset's action
MOST_AHEAD_S = 0.2  # a label farther ahead is of another place


def frames_ahead(delay: int, control_hz: int) -> int:
    """Frames by which labels are taken ahead for a delay in frames."""
    return min(delay, round(MOST_AHEAD_S * control_hz))


def ahead(action: np.ndarray, area: np.ndarray, episode: np.ndarray, frames: int) -> np.ndarray:
    """Actions (F, 3 + C) whose labels in touch, and for as many frames after it, are those so many frames on.

    Contact areas `area` and numbers of the episodes are (F,); labels stay within their episode.
    """
    moved = action.copy()
    for k in np.unique(episode):
        rows = np.flatnonzero(episode == k)
        touch = area[rows] >= SPECKS
        near = np.convolve(touch, np.ones(frames + 1), "full")[: len(rows)] > 0
        later = rows[np.minimum(np.arange(len(rows)) + frames, len(rows) - 1)]
        moved[rows[near]] = action[later[near]]
    return moved
