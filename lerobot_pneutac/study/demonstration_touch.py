"""What a model of the finger makes of an episode's touch, read between its replays.

A soft finger presses with the force that its bend lacks, whatever the gel: how deep that is, is the gel's own
matter, and of another law in every gel. So an imprint is explained by the force, not by the twin's depth.
"""

import numpy as np

from lerobot_pneutac.study.demonstration_data import MORE_RAD, EpisodeData

APART_RAD = np.linspace(-0.10, 0.18, 29)  # by which an object may stand elsewhere
TYPICAL = 2.0  # power of the force with which imprints grow where faint light is not counted
LEAST_N = 0.1


def touch(e: EpisodeData, more_rad: np.ndarray, growth: float, late: float) -> np.ndarray:
    """Imprint strength (T,) predicted, with the episode's own gain and bend apart."""
    grid = np.array(MORE_RAD)
    x = np.clip(more_rad[:, None] + APART_RAD, grid[0], grid[-1])
    k = np.clip(np.searchsorted(grid, x) - 1, 0, len(grid) - 2)
    share = (x - grid[k]) / (grid[k + 1] - grid[k])
    rows = np.arange(len(e))[:, None]
    force = np.maximum(e.press_n[rows, k] * (1 - share) + e.press_n[rows, k + 1] * share, 0.0)
    shown = force**growth
    whole, part = divmod(late, 1.0)
    back = [np.clip(np.arange(len(e)) - int(whole) - d, 0, None) for d in (0, 1)]
    shown = (1 - part) * shown[back[0]] + part * shown[back[1]]
    B, y = shown[e.contact], e.imprint[e.contact]
    gain = np.maximum(y @ B / np.maximum((B**2).sum(0), 1e-12), 0.0)
    j = int(np.clip(np.argmin(((y[:, None] - gain * B) ** 2).sum(0)), 1, len(APART_RAD) - 2))
    # About the best of the grid both are fitted as a line, so that the error moves smoothly with the model.
    ground = np.stack([shown[:, j], (shown[:, j + 1] - shown[:, j - 1]) / 2], 1)
    A = ground[e.contact]
    weights = np.linalg.lstsq(A, y, rcond=None)[0]
    if weights[0] <= 0 or abs(weights[1]) > weights[0]:
        weights = np.array([gain[j], 0.0])
    return ground @ weights


def imprint_per_rad(e: EpisodeData) -> float:
    """By how many levels an episode's imprint grows with the bend, where it is strong."""
    middle = MORE_RAD.index(0.0)
    force = e.press_n[:, middle]
    slope = (e.press_n[:, middle + 1] - e.press_n[:, middle - 1]) / (
        MORE_RAD[middle + 1] - MORE_RAD[middle - 1]
    )
    strong = e.contact & (e.imprint > 0.5 * e.imprint.max()) & (force > LEAST_N)
    if not strong.any():
        return max(float(e.imprint.max()), 0.1)
    return max(float(np.median(TYPICAL * e.imprint[strong] * slope[strong] / force[strong])), 0.05)
