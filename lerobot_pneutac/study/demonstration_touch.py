"""What a model of the finger makes of an episode's touch, read between its replays.

A soft finger presses with the force that its bend lacks, whatever the gel: how deep that is, is the gel's own
matter, and of another law in every gel. So an imprint is explained by the force, not by the twin's depth.
"""

import numpy as np

from lerobot_pneutac.study.demonstration_data import MORE_RAD, EpisodeData
from pneutac_sim.twin import Twin
from pneutac_sim.world.soft_finger import GEL_ALONG_M

APART_RAD = np.linspace(-0.10, 0.18, 29)  # by which an object may stand elsewhere
ZOOM = np.linspace(-1, 1, 11)  # about the best of these, each time with a fifth of the step
TYPICAL = 2.0  # power of the force with which imprints grow where faint light is not counted
LEAST_N = 0.1
LEAST_PER_RAD = 0.05  # levels: fainter imprints tell nothing of the bend


def touch(e: EpisodeData, more_rad: np.ndarray, growth: float, late: float) -> tuple[np.ndarray, float]:
    """Imprint strength (T,) predicted, with the episode's own gain, levels/N^growth, and bend apart."""
    grid, y = np.array(MORE_RAD), e.imprint[e.contact]
    rows, back = (
        np.arange(len(e))[:, None],
        [np.clip(np.arange(len(e)) - int(late) - d, 0, None) for d in (0, 1)],
    )

    def shown(apart: np.ndarray) -> np.ndarray:
        x = np.clip(more_rad[:, None] + apart, grid[0], grid[-1])
        k = np.clip(np.searchsorted(grid, x) - 1, 0, len(grid) - 2)
        share = (x - grid[k]) / (grid[k + 1] - grid[k])
        force = np.maximum(e.press_n[rows, k] * (1 - share) + e.press_n[rows, k + 1] * share, 0.0)
        return (1 - late % 1) * (force**growth)[back[0]] + late % 1 * (force**growth)[back[1]]

    tried, step = APART_RAD, APART_RAD[1] - APART_RAD[0]
    # As fine as that, the best moves smoothly with the model: a coarse grid makes its derivatives nonsense.
    for _ in range(4):
        B = shown(tried)[e.contact]
        gain = np.maximum(y @ B / np.maximum((B**2).sum(0), 1e-12), 0.0)
        best = np.clip(tried[np.argmin(((y[:, None] - gain * B) ** 2).sum(0))], APART_RAD[0], APART_RAD[-1])
        tried, step = best + step * ZOOM, step / 5
    ground = shown(np.array([best]))[:, 0]
    gain = max(float(y @ ground[e.contact]) / max(float((ground[e.contact] ** 2).sum()), 1e-12), 0.0)
    return gain * ground, gain


def imprint_per_rad(episodes: list[EpisodeData], stiff_n_per_rad: float) -> float:
    """By how many levels imprints grow with the bend, where they are strong: the median of the episodes.

    One for all: a faint imprint tells less of the bend, not more. Where an object gives way, or is gone once
    it is pressed, more bend does not press harder; there the finger's own stiffness says how much it takes.
    """
    middle, slopes = MORE_RAD.index(0.0), []
    for e in episodes:
        force = e.press_n[:, middle]
        by_rad = np.diff(e.press_n[:, [middle - 1, middle + 1]])[:, 0] / (
            MORE_RAD[middle + 1] - MORE_RAD[middle - 1]
        )
        strong = e.contact & (e.imprint > 0.5 * e.imprint.max()) & (force > LEAST_N)
        if strong.any():
            share = np.maximum(by_rad, stiff_n_per_rad)[strong] / force[strong]
            slopes.append(float(np.median(TYPICAL * e.imprint[strong] * share)))
    return max(float(np.median(slopes)), LEAST_PER_RAD) if slopes else LEAST_PER_RAD


def stiffness_n_per_rad(twin: Twin) -> float:
    """Force at the gel of a finger whose gel is held in place, per bend that its joints share alike."""
    arms_m = 1e-3 * (twin.length_mm - np.asarray(twin.spine_joint_positions_mm)) + GEL_ALONG_M
    return float(twin.parameter("joint_stiffness_nm_per_rad") * arms_m.mean() / (arms_m**2).sum())
