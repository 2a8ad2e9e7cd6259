"""How well a rendered tactile image agrees with a photograph, in 8-bit levels.

Whole-frame scores flatter everyone, since most of a tactile image is the rest image. What separates models
is the contact region, a disc of twice the contact radius, and the correlation of what the contact changes
there. Whole frames are correlated channel by channel and averaged, since correlating the channels together
would reward the mere order of their mean levels; differences to the rest image have no such level, and their
channels are correlated together, so that a wrong balance of colours counts.
"""

from dataclasses import dataclass, fields

import numpy as np

CONTACT_DISC = 2.0  # radius of the contact region, in contact radii


@dataclass
class ImageScores:
    """Agreement of one image, or the mean of several.

    Attributes:
        rmse: whole frame, levels.
        psnr: whole frame, dB.
        ncc: whole frame, -1 to 1.
        contact_rmse: in the contact region, levels.
        contact_dncc: NCC of (image - rest) in the contact region; 0 where the prediction changes nothing.
    """

    rmse: float
    psnr: float
    ncc: float
    contact_rmse: float
    contact_dncc: float

    @classmethod
    def mean(cls, scores: list["ImageScores"]) -> "ImageScores":
        return cls(*(float(np.mean([getattr(s, f.name) for s in scores])) for f in fields(cls)))


def rmse(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square difference of two arrays of one shape."""
    return float(np.sqrt(np.mean(np.square(np.asarray(a, np.float64) - b))))


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB against 255 levels; infinite for equal images."""
    e = rmse(a, b)
    return float(20 * np.log10(255 / e)) if e else float("inf")


def ncc(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson correlation over pixels, mean of the channels (last axis); a constant channel counts as 0."""
    a = np.asarray(a, np.float64).reshape(-1, a.shape[-1])
    b = np.asarray(b, np.float64).reshape(-1, b.shape[-1])
    a, b = a - a.mean(0), b - b.mean(0)
    norm = np.sqrt((a * a).sum(0) * (b * b).sum(0))
    return float(np.mean(np.divide((a * b).sum(0), norm, out=np.zeros_like(norm), where=norm > 0)))


def disc(shape: tuple[int, ...], x_px: float, y_px: float, radius_px: float) -> np.ndarray:
    """Pixels (H, W) with their centre within `radius_px` of (x, y); pixel (i, j) covers x in [j, j + 1)."""
    y, x = np.ogrid[: shape[0], : shape[1]]
    return np.hypot(x + 0.5 - x_px, y + 0.5 - y_px) < radius_px


def score(
    image: np.ndarray, real: np.ndarray, rest: np.ndarray, x_px: float, y_px: float, radius_px: float
) -> ImageScores:
    """Scores a prediction.

    Args:
        image: rendered image (H, W, 3), levels.
        real: photograph, same shape.
        rest: the sensor's image without contact, same shape.
        x_px: column of the contact centre, with the left edge of the image at 0.
        y_px: row of the contact centre, with the upper edge at 0.
        radius_px: contact radius.
    """
    image, real, rest = (np.asarray(a, np.float64) for a in (image, real, rest))
    m = disc(image.shape, x_px, y_px, CONTACT_DISC * radius_px)
    return ImageScores(
        rmse(image, real),
        psnr(image, real),
        ncc(image, real),
        rmse(image[m], real[m]),
        ncc((image - rest)[m].reshape(-1, 1), (real - rest)[m].reshape(-1, 1)),
    )
