"""Photographs of a body and its renderings, and where their silhouettes differ."""

import cv2
import numpy as np

from pneutac_sim.photo_fit.objective import SOLID, MaskedPhotograph, Objective

HEIGHT = 220  # px of a picture


def strip(objective: Objective, positions: np.ndarray, photographs: list[MaskedPhotograph]) -> np.ndarray:
    """Photographs above, renderings below and differing silhouettes last, uint8 (H, W, 3).

    Args:
        objective: draws.
        positions: (T, P, 3) of the particles at each pressure, m.
        photographs: their `state` counts `positions`.
    """
    columns = []
    low, high = _crop(photographs)
    for p in photographs:
        drawn = objective.render(positions[p.state], p.camera)
        white = drawn.image.clip(0, 1) + (1 - drawn.alpha.clip(0, 1))[..., None]
        edges = differing(p.mask, drawn.alpha > SOLID)
        real = np.where(p.mask[..., None], p.image, 255)
        stack = [a[low[0] : high[0], low[1] : high[1]] for a in (real, 255 * white.clip(0, 1), edges)]
        size = (round(HEIGHT * (high[1] - low[1]) / (high[0] - low[0])), HEIGHT)
        columns.append(
            np.concatenate(
                [cv2.resize(a.astype(np.uint8), size, interpolation=cv2.INTER_AREA) for a in stack]
            )
        )
    return np.concatenate(columns, 1)


def differing(photograph: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Two silhouettes, bool (H, W): grey where both are, red where the photograph's alone, blue the other's.

    Returns:
        uint8 (H, W, 3), on white.
    """
    image = np.full((*photograph.shape, 3), 255, np.uint8)
    image[photograph & drawn] = (222, 226, 230)
    image[photograph & ~drawn] = (194, 65, 12)
    image[~photograph & drawn] = (11, 110, 153)
    return image


def _crop(photographs: list[MaskedPhotograph]) -> tuple[np.ndarray, np.ndarray]:
    """Corners (row, column) of a window round all masks."""
    corners = [np.argwhere(p.mask) for p in photographs]
    size = np.array(photographs[0].mask.shape)
    low = np.min([c.min(0) for c in corners], 0) - 12
    high = np.max([c.max(0) for c in corners], 0) + 12
    return np.maximum(low, 0), np.minimum(high, size)
