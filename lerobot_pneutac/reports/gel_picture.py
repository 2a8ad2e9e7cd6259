"""A gel's photographs above what a twin predicts."""

import numpy as np
from PIL import Image

from pneutac_datasets.recording.gel import GelRecording, GelSample

PICTURES = 6  # held-out images in the picture grid


def picture_grid(data: GelRecording, ours: list[np.ndarray], first: GelSample) -> np.ndarray:
    """Rows recorded, ours, error (grey is none, four times exaggerated); columns rest, first, held-out."""
    heldout = data.heldout
    spaced = np.linspace(0, len(heldout) - 1, PICTURES).astype(int)
    picks = [heldout[i] for i in np.unique(spaced)] if heldout else []
    columns = [_column(data.rest, data.rest)]
    columns += [_column(data.samples[i].image, ours[i]) for i in [data.samples.index(first), *picks]]
    return np.concatenate(columns, axis=1)


def _column(recorded: np.ndarray, ours: np.ndarray) -> np.ndarray:
    error = np.clip(128 + 4.0 * (ours.astype(float) - recorded), 0, 255).astype(np.uint8)
    size = (round(160 * recorded.shape[1] / recorded.shape[0] * 4 / 3), round(160 * 4 / 3))
    small = [
        np.asarray(Image.fromarray(a).resize(size, Image.Resampling.BOX)) for a in (recorded, ours, error)
    ]
    return np.pad(
        np.concatenate([np.pad(a, ((0, 4), (0, 0), (0, 0)), constant_values=255) for a in small]),
        ((0, 0), (0, 4), (0, 0)),
        constant_values=255,
    )
