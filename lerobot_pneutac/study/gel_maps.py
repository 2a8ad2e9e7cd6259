"""Where in the image a gel's twin fails."""

import numpy as np
from scipy.ndimage import map_coordinates

from pneutac_datasets.recording.gel import GelSample

GAIN = 4.0  # maps are shown this many times brighter
CONTACT_PX, CONTACT_RADII = 121, 3.0  # of the map around a contact, and how far it reaches


def pictures(samples: list[GelSample], differences: list[list[np.ndarray]]) -> list[tuple[np.ndarray, str]]:
    """Maps of some models side by side, uint8 (H, W, 3), with what they show.

    Args:
        samples: n photographs.
        differences: of each model, n of predicted - photographed, int16 (H, W, 3).
    """
    planes = np.concatenate([np.clip(GAIN * plane(each), 0, 255) for each in differences], 1)
    contacts = [np.clip(128 + GAIN * contact(samples, each), 0, 255) for each in differences]
    return [
        (
            planes.astype(np.uint8),
            f"Root mean square error over the test images, {GAIN:g} times brighter; left as it is, right "
            "with all effects found.",
        ),
        (
            np.concatenate(contacts, 1).astype(np.uint8).repeat(2, 0).repeat(2, 1),
            "Mean of rendered less photographed around the contact, three contact radii each way; grey is "
            "none.",
        ),
    ]


def plane(differences: list[np.ndarray]) -> np.ndarray:
    """Root mean square in the image plane (H, W, 3), levels."""
    return np.sqrt(np.mean([np.square(d.astype(float)) for d in differences], axis=0))


def contact(samples: list[GelSample], differences: list[np.ndarray]) -> np.ndarray:
    """Signed mean around the contact (121, 121, 3), from -3 to 3 contact radii, levels."""
    t = np.linspace(-CONTACT_RADII, CONTACT_RADII, CONTACT_PX)
    x, y = np.meshgrid(t, t)
    total, count = np.zeros((CONTACT_PX, CONTACT_PX, 3)), np.zeros((CONTACT_PX, CONTACT_PX, 1))
    for s, difference in zip(samples, differences, strict=True):
        d = difference.astype(float)
        at = [s.y_px - 0.5 + y * s.radius_px, s.x_px - 0.5 + x * s.radius_px]
        inside = (at[0] >= 0) & (at[0] <= d.shape[0] - 1) & (at[1] >= 0) & (at[1] <= d.shape[1] - 1)
        shown = np.stack([map_coordinates(d[..., k], at, order=1) for k in range(3)], -1)
        total += shown * inside[..., None]
        count += inside[..., None]
    return total / np.maximum(count, 1)
