"""A photograph of an indentation with its rest image: whether the two can be of one sensor.

How well a rendered tactile image agrees with a photograph, in 8-bit levels.

Whole-frame scores flatter everyone, since most of a tactile image is the rest image. What separates models
is the contact region, a disc of twice the contact radius, and the correlation of what the contact changes
there. Whole frames are correlated channel by channel and averaged, since correlating the channels together
would reward the mere order of their mean levels; differences to the rest image have no such level, and their
channels are correlated together, so that a wrong balance of colours counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import cv2
import numpy as np
from scipy.ndimage import gaussian_laplace

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.probe import COLS, ROWS

# Of 66 photographs of three real sensors, an indentation has at least 2.5 times the rest image's relief at
# the contact, its blurred difference is at least 3 times that elsewhere, and away from the contact it
# correlates with the rest image above 0.96, but by only 0.73 with that of another DIGIT. The limits leave
# room for weaker contacts and noisier cameras.
MIN_CONTRAST = 1.5
MIN_LIKENESS = 0.85
# At most a sixth of a contact's pixels in those photographs, and none of a rest image's, are at their limit.
SATURATED_LEVEL, MAX_SATURATED = 254, 0.5

REST_LEVELS, REST_PEAK = 8.0, 6.0  # of a place in one rest image that is not in another

MIRRORED = (("mirrored left to right", -1, 1), ("mirrored top to bottom", 1, -1), ("turned by half", -1, -1))


def _disc(image: np.ndarray, press: Press, px_per_mm: float, radii: float) -> np.ndarray:
    x, y = press_px(press, image.shape, px_per_mm)
    return disc(image.shape, x, y, radii * press.contact_radius_mm * px_per_mm)


def press_px(press: Press, shape: tuple[int, ...], px_per_mm: float) -> tuple[float, float]:
    """Column and row of a press in an image of `shape`."""
    return shape[1] / 2 + press.x_mm * px_per_mm, shape[0] / 2 + press.y_mm * px_per_mm


FAR_ENOUGH = 0.1  # share of a photograph that must lie away from its contact to measure its light
NEAR_RADII = 3.0  # pixels within so many contact radii belong to the gel, those beyond to the session


@dataclass(frozen=True)
class Earlier:
    """A press that was over before a photograph was taken."""

    press: Press  # which indenter, where and how deep
    held_s: float  # how long it was in the gel
    since_s: float  # from its release to the photograph


@dataclass(eq=False)
class PressPhotograph:
    """One indentation."""

    press: Press  # which indenter, where and how deep, as the recording states it
    image: np.ndarray  # uint8 (H, W, 3)
    rest: np.ndarray  # the image without contact of the same session, uint8 (H, W, 3)
    clock: float = 0.0  # when in the session, from 0 to 1
    # attributes of the press to the standard deviation with which they are stated; all others hold
    sd: dict[str, float] = field(default_factory=dict)
    # presses since the rest image that were over before; empty if the recording does not state them
    earlier: Sequence[Earlier] = ()

    def near(self, px_per_mm: float, radii: float = NEAR_RADII) -> np.ndarray:
        """Pixels (H, W) within so many contact radii of the press."""
        return _disc(self.rest, self.press, px_per_mm, radii)

    def far(self, px_per_mm: float) -> np.ndarray:
        """Probe grid cells (80, 59) whose pixels all lie away from the contact."""
        return to_grid(~self.near(px_per_mm)) > 0.99


def to_grid(image: np.ndarray) -> np.ndarray:
    """Mean of an image (H, W) or (H, W, C) over each cell of the probe grid, float32."""
    return cv2.resize(image.astype(np.float32), (COLS, ROWS), interpolation=cv2.INTER_AREA)


def smooth_change(difference: np.ndarray, rest: np.ndarray, quiet: np.ndarray) -> np.ndarray:
    """The smooth part of what the light did since a rest image, (80, 59, 3) levels, where nothing touches.

    A gain and a quadratic in x and y for each channel, fitted to the difference in cells `quiet` (80, 59).
    """
    y, x = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLS), indexing="ij")
    out = np.empty(rest.shape)
    for k in range(3):
        basis = np.stack([rest[..., k], np.ones_like(x), x, y, x * x, y * y, x * y], -1)
        out[..., k] = basis @ np.linalg.lstsq(basis[quiet], difference[..., k][quiet], rcond=None)[0]
    return out


def check_pair(rest: np.ndarray, indentation: np.ndarray, press: Press, px_per_mm: float) -> None:
    """Raises InputError, in one sentence, where the pair is not a rest and an indentation image."""
    _check_shapes(rest, indentation, press, px_per_mm)
    near, far = _disc(rest, press, px_per_mm, 1.2), ~_disc(rest, press, px_per_mm, 3.0)
    if not near.any():
        raise InputError(
            f"the contact is only {2 * press.contact_radius_mm * px_per_mm:.1f} pixels wide; "
            "correct depth_mm or px_per_mm."
        )
    for image, mask, what in ((rest, np.ones_like(near), "rest image"), (indentation, near, "contact")):
        if saturated(image, mask):
            raise InputError(
                f"most of the {what} is saturated in a channel ({SATURATED_LEVEL} levels and more); "
                "lower the camera's exposure or gain and take the photographs again."
            )
    difference = _blurred(indentation, rest, px_per_mm)
    there, elsewhere = _contrast(difference, press, px_per_mm)
    found = _stands_out(there, elsewhere)
    if not found:
        _check_mirrored(difference, press, px_per_mm)
    if far.mean() > FAR_ENOUGH:
        likeness = ncc(rest[far], indentation[far])
        if likeness < MIN_LIKENESS:
            raise InputError(
                f"away from the contact the rest image and the indentation image correlate by only "
                f"{likeness:.2f}; the rest image seems to be of another sensor or session."
            )
    x, y = press_px(press, rest.shape, px_per_mm)
    if not found:
        raise InputError(
            f"the indentation image shows no contact at ({x:.0f}, {y:.0f}) px: its difference to rest is "
            f"{there:.1f} levels there and {elsewhere:.1f} elsewhere; press harder, or correct the position "
            f"or the indenter, whose contact is {2 * press.contact_radius_mm:.2g} mm wide here."
        )
    scale = press.contact_radius_mm * px_per_mm / 3
    if _relief(indentation, near, scale) < _relief(rest, near, scale):
        raise InputError(
            f"the rest image has more relief at ({x:.0f}, {y:.0f}) px than the indentation image; "
            "they seem to be swapped."
        )


def shows_contact(rest: np.ndarray, indentation: np.ndarray, press: Press, px_per_mm: float) -> bool:
    """Whether the image differs from the rest image at the press more than elsewhere."""
    return _stands_out(*_contrast(_blurred(indentation, rest, px_per_mm), press, px_per_mm))


def saturated(image: np.ndarray, mask: np.ndarray) -> bool:
    """Whether most pixels of a mask (H, W) are at their limit in some channel."""
    return bool(mask.any()) and bool(((image[mask] >= SATURATED_LEVEL).mean(0) > MAX_SATURATED).any())


def _blurred(indentation: np.ndarray, rest: np.ndarray, px_per_mm: float) -> np.ndarray:
    """Difference to rest, its noise averaged within a grid cell."""
    blur = 0.15 * px_per_mm
    size = 2 * int(4 * blur + 0.5) + 1
    difference = indentation.astype(np.float32) - rest
    return cv2.GaussianBlur(difference, (size, size), blur, borderType=cv2.BORDER_REFLECT)


def _stands_out(there: float, elsewhere: float) -> bool:
    return there >= max(MIN_CONTRAST * elsewhere, 1.0)


def _check_shapes(rest: np.ndarray, indentation: np.ndarray, press: Press, px_per_mm: float) -> None:
    if rest.shape != indentation.shape:
        raise InputError(
            f"the indentation image is {_size(indentation)} but the rest image is {_size(rest)} pixels; "
            "give two images of one sensor at one size."
        )
    x, y = press_px(press, rest.shape, px_per_mm)
    if not (0 <= x < rest.shape[1] and 0 <= y < rest.shape[0]):
        raise InputError(
            f"the contact at ({x:.0f}, {y:.0f}) px lies outside the image of {_size(rest)} pixels; "
            "correct x_mm, y_mm (measured from the image's centre) or contact_x_px, contact_y_px."
        )
    if np.array_equal(rest, indentation):
        raise InputError(
            "the rest image and the indentation image are the same picture; "
            "give one without and one with contact."
        )


def _check_mirrored(difference: np.ndarray, press: Press, px_per_mm: float) -> None:
    x, y = press_px(press, difference.shape, px_per_mm)
    for how, sx, sy in MIRRORED:
        turned = replace(press, x_mm=sx * press.x_mm, y_mm=sy * press.y_mm)
        there, elsewhere = _contrast(difference, turned, px_per_mm)
        if there >= max(2 * MIN_CONTRAST * elsewhere, 1.0):
            u, v = press_px(turned, difference.shape, px_per_mm)
            raise InputError(
                f"the indentation image shows no contact at ({x:.0f}, {y:.0f}) px but one at ({u:.0f}, "
                f"{v:.0f}) px: the images are {how} against x_mm, y_mm; turn them, or change the signs."
            )


def _relief(image: np.ndarray, near: np.ndarray, scale: float) -> float:
    """Root mean square in the mask `near` of bumps of so many pixels; a rest image varies more slowly."""
    rows, cols = (np.flatnonzero(near.any(axis)) for axis in (1, 0))
    margin = int(4 * scale)
    around = (
        slice(max(rows[0] - margin, 0), rows[-1] + margin),
        slice(max(cols[0] - margin, 0), cols[-1] + margin),
    )
    bumps = [gaussian_laplace(image[..., k][around].astype(np.float32), scale) for k in range(3)]
    return float(np.sqrt(np.mean(np.square(np.stack(bumps, -1)[near[around]]))))


def _contrast(difference: np.ndarray, press: Press, px_per_mm: float) -> tuple[float, float]:
    """Root mean square of a difference at the contact, and far from it (0 where all is near), levels."""
    near, far = (_disc(difference, press, px_per_mm, radii) for radii in (1.2, 3.0))
    squared = np.square(difference).mean(2)
    return tuple(float(np.sqrt(squared[m].mean())) if m.any() else 0.0 for m in (near, ~far))


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


def cells(image: np.ndarray, px_per_mm: float) -> np.ndarray:
    """Means of cells of a tenth of a millimetre, float32 (rows, columns, 3)."""
    cell = cell_px(px_per_mm)
    rows, columns = (n // cell for n in image.shape[:2])
    small = image[: rows * cell, : columns * cell]
    return cv2.resize(small, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32)


def cell_px(px_per_mm: float) -> int:
    """Pixels along a cell of `cells`."""
    return max(1, round(0.1 * px_per_mm))


@dataclass(frozen=True)
class RestDifference:
    """How a rest image differs from another one of the same gel."""

    gain: float  # the other's brightness as a share of this one's, mean of the colours
    levels: float  # largest difference of places half a millimetre wide, in equal brightness of each colour
    typical: float  # median of these differences
    # x_mm, y_mm: where it is largest, from the image's centre
    x_mm: float
    y_mm: float

    @property
    def shows(self) -> bool:
        """Whether one place stands out, as where something touched one of the two.

        Of five real and generated sensors no place is more than 9 levels or 4.5 times the median off.
        """
        return self.levels > max(REST_LEVELS, REST_PEAK * self.typical)

    @classmethod
    def of(cls, mine: np.ndarray, other: np.ndarray, px_per_mm: float, free: np.ndarray | None = None):
        """Of two images as `cells`, where the mask `free` (rows, columns) is true."""
        free = np.ones(mine.shape[:2], bool) if free is None else free
        cell = cell_px(px_per_mm)
        gain = np.median(other[free] / np.maximum(mine[free], 1), 0)
        off = np.where(free[..., None], mine * gain - other, 0)
        off = cv2.GaussianBlur(off, (0, 0), 0.5 * px_per_mm / cell)
        levels = np.where(free, np.sqrt(np.square(off).mean(2)), 0)
        at = np.array(np.unravel_index(np.argmax(levels), levels.shape))
        y_mm, x_mm = ((at + 0.5) - np.array(levels.shape) / 2) * cell / px_per_mm
        typical = float(np.median(levels[free]))
        return cls(float(gain.mean()), float(levels.max()), typical, float(x_mm), float(y_mm))


def rest_changed(earlier: np.ndarray | None, rest: np.ndarray, px_per_mm: float) -> list[str]:
    """A note where a rest image shows something that the twin's earlier one, if it has one, does not."""
    if earlier is None or earlier.shape != rest.shape:
        return []
    found = RestDifference.of(*(cells(i, px_per_mm) for i in (rest, earlier)), px_per_mm)
    if not found.shows:
        return []
    where = f"({found.x_mm:.1f}, {found.y_mm:.1f}) mm"
    seen = f"the rest image shows something at {where} that the twin's earlier one does not"
    again = "if it is not the gel's own light, take it again"
    return [f"{seen}, {found.levels:.0f} levels strong; {again}."]


CONTACT_DISC = 2.0  # radius of the contact region, in contact radii


@dataclass
class ImageScores:
    """Agreement of one image, or the mean of several."""

    rmse: float  # whole frame, levels
    psnr: float  # whole frame, dB
    ncc: float  # whole frame, -1 to 1
    contact_rmse: float  # in the contact region, levels
    contact_dncc: float  # NCC of (image - rest) in the contact region; 0 where the prediction changes nothing

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
    """Scores a rendered image against a photograph; these and the rest image are (H, W, 3) levels.

    The contact is a disc whose centre is (x, y) px from the image's left and upper edge.
    """
    image, real, rest = (np.asarray(a, np.float64) for a in (image, real, rest))
    m = disc(image.shape, x_px, y_px, CONTACT_DISC * radius_px)
    of_contact = ncc((image - rest)[m].reshape(-1, 1), (real - rest)[m].reshape(-1, 1))
    whole = rmse(image, real), psnr(image, real), ncc(image, real)
    return ImageScores(*whole, rmse(image[m], real[m]), of_contact)
