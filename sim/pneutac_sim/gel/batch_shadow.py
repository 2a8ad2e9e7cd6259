"""Cast shadows of many surfaces at once, see `gel.batch`."""

import math

import numpy as np
import torch

from pneutac_sim.gel.probe import COLS, ROWS


class CastShadows:
    """`effects.shadow.cast` of some channels: cells hand on the shadow's height, those of a side at once.

    The cells of a side are gone through as often as a shadow may be handed on from the first to the last
    of them, or until one of the deepest imprint has ended; sides of different channels together.

    Args:
        towards: x and y in mm from each cell to each channel's light, (2, channels, 80, 59).
        slope: tan(elevation) of each light.
        cell_mm: grid spacing along x and y.
        device: of PyTorch.
    """

    def __init__(self, towards, slope, cell_mm, device):
        hx, hy = cell_mm
        k, i, j = np.indices(towards.shape[1:])
        ex, ey = towards
        di, dj = np.where(ey > 0, 1, -1), np.where(ex > 0, 1, -1)
        px, py = np.abs(ex) / hx, np.abs(ey) / hy
        wide = px >= py  # it leaves through the column beside
        near_i, near_j = np.where(wide, i, i + di), np.where(wide, j + dj, j)
        leaves = (near_i < 0) | (near_i >= ROWS) | (near_j < 0) | (near_j >= COLS)

        def index(a, b):
            return (k * ROWS + a.clip(0, ROWS - 1)) * COLS + b.clip(0, COLS - 1)

        near, other = index(near_i, near_j), index(i + di, j + dj)
        outside = (i + di < 0) | (i + di >= ROWS) | (j + dj < 0) | (j + dj >= COLS)
        other = np.where(outside, near, other)
        steep = np.maximum(np.maximum(px, py), 1e-9)
        f = np.minimum(px, py) / steep
        drop = slope[:, None, None] * np.hypot(ex, ey) / steep
        side = 2 * (di < 0) + (dj < 0)
        turn = np.stack([np.searchsorted(np.unique(s), s) for s in side]) if len(side) else side

        def sent(a):
            return torch.tensor(a.reshape(-1, 1), dtype=torch.float32, device=device)

        self._turns = []
        for t in range(4):
            acts = (turn == t) & ~leaves
            if acts.any():
                cells = torch.tensor(np.stack([near, other]).reshape(-1), device=device)
                at_most = _longest(near, other, acts), max(drop[acts].min(), 1e-9)
                self._turns.append((cells, sent(f), sent(np.where(acts, drop, np.inf)), *at_most))

    def cast(self, u: torch.Tensor, deepest: float) -> torch.Tensor:
        """Heights in mm over surfaces (B, rows, columns) of `deepest` mm, (B, channels, rows, columns)."""
        flat = u.reshape(len(u), -1).T
        channels = len(self._turns[0][1]) // len(flat)
        S = flat.repeat(channels, 1)
        for cells, f, drop, longest, least_mm in self._turns:
            for _ in range(min(longest, math.ceil(deepest / least_mm))):
                near, other = S.index_select(0, cells).view(2, *S.shape)
                S = torch.maximum(S, torch.lerp(near, other, f).sub_(drop))
        return (S.T.reshape(len(u), channels, -1) - flat.T[:, None]).reshape(len(u), channels, *u.shape[1:])


def _longest(near: np.ndarray, other: np.ndarray, acts: np.ndarray) -> int:
    """How many cells hand on, one after another, at most."""
    steps, near, other, acts = np.zeros(near.size, int), near.ravel(), other.ravel(), acts.ravel()
    for n in range(near.size):
        longer = np.where(acts, 1 + np.maximum(steps[near], steps[other]), 0)
        if (longer == steps).all():
            return n
        steps = longer
    return near.size
