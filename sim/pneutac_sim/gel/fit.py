"""Calibrates a gel from one rest and one indentation image: light by least squares, decay by a search."""

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_laplace
from scipy.optimize import minimize_scalar

from pneutac_sim.errors import InputError
from pneutac_sim.gel import metrics
from pneutac_sim.gel.contact import quiet_threshold
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import gradient, upsample
from pneutac_sim.gel.probe import COLS, ROWS, THICKNESS_MM, probe_grid
from pneutac_sim.gel.surface import surface

DECAY_RANGE_MM = (0.3, 4.0)  # from a skin-thin layer to nearly Hertz' half-space on a 16 mm window
MIN_THRESHOLD_LEVELS = 4.0  # below this, rounding and image compression alone would count as contact

# Of 66 photographs of three real sensors, an indentation has at least 2.5 times the rest image's relief at
# the contact, its blurred difference is at least 3 times that elsewhere, and away from the contact it
# correlates with the rest image above 0.96, but by only 0.73 with that of another DIGIT. The limits leave
# room for weaker contacts and noisier cameras.
MIN_CONTRAST = 1.5
MIN_LIKENESS = 0.85


def fit_gel(
    rest: np.ndarray,
    indentation: np.ndarray,
    press: Press,
    px_per_mm: float,
    multiply: bool = True,
    thickness_mm: float = THICKNESS_MM,
) -> tuple[GelModel, int]:
    """Fits L, c_d, the decay length and the contact threshold.

    Args:
        rest: image without contact, uint8 (H, W, 3).
        indentation: image under the indenter, uint8, same shape.
        press: which indenter, where and how deep.
        px_per_mm: scale of the images.
        multiply: whether light is multiplied by the rest colour of the pixel, see `GelModel`.
        thickness_mm: gel thickness.

    Returns:
        The calibrated gel at the images' own resolution, and how many decay lengths were tried.

    Raises:
        InputError: the pair cannot be what it is said to be, see `check_pair`.
    """
    check_pair(rest, indentation, press, px_per_mm)
    gel = GelModel(rest, np.zeros((3, 2)), np.zeros(3), px_per_mm, thickness_mm, multiply=multiply)
    difference = indentation.astype(np.float32) - rest
    weight = gel.weight
    depth = press_depth(press, gel)

    def solve(decay_mm: float):
        gel.decay_mm = float(decay_mm)
        features, touched = _features(gel, depth)
        error, coefficients = 0.0, []
        for k in range(3):
            A = features * weight[touched, k, None]
            AA, Ab = A.T @ A, A.T @ difference[touched, k]  # normal equations, 3 x 3 and well conditioned
            c, *_ = np.linalg.lstsq(AA, Ab, rcond=None)
            coefficients.append(c)
            error += c @ AA @ c - 2 * c @ Ab  # less the constant |difference|^2 of the whole image
        return error, np.array(coefficients)

    search = minimize_scalar(
        lambda log: solve(np.exp(log))[0],
        bounds=np.log(DECAY_RANGE_MM),
        method="bounded",
        options={"xatol": 0.03},
    )
    _, coefficients = solve(np.exp(search.x))
    gel.light, gel.depth_light = coefficients[:, :2].astype(float), coefficients[:, 2].astype(float)
    quiet = ~_disc(rest, press, px_per_mm, 3.0)
    if quiet.any():
        gel.threshold_levels = max(MIN_THRESHOLD_LEVELS, quiet_threshold(difference, quiet))
    return gel, int(search.nfev) + 1


def press_depth(press: Press, gel: GelModel) -> np.ndarray:
    """Probe grid (80, 59) in mm of a bench indenter on this gel."""
    return probe_grid(*press.shapes(), window_mm=gel.window_mm, thickness_mm=gel.thickness_mm)


def _features(gel: GelModel, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and displacement (n, 3) at the pixels (H, W) that the press moves noticeably."""
    h, w = gel.rest_image.shape[:2]
    cell = gel.window_mm[0] / COLS, gel.window_mm[1] / ROWS
    u = surface(depth, cell, gel.decay_mm)
    fields = [upsample(f, h, w) for f in (*gradient(u, cell), u)]
    touched = fields[2] > 0.02 * u.max()
    return np.stack([f[touched] for f in fields], -1).astype(np.float64), touched


def _disc(image: np.ndarray, press: Press, px_per_mm: float, radii: float) -> np.ndarray:
    """Pixels within so many contact radii of the press."""
    x, y = press_px(press, image.shape, px_per_mm)
    return metrics.disc(image.shape, x, y, radii * press.contact_radius_mm * px_per_mm)


def press_px(press: Press, shape: tuple[int, ...], px_per_mm: float) -> tuple[float, float]:
    """Column and row of a press in an image of `shape`."""
    return shape[1] / 2 + press.x_mm * px_per_mm, shape[0] / 2 + press.y_mm * px_per_mm


def check_pair(rest: np.ndarray, indentation: np.ndarray, press: Press, px_per_mm: float) -> None:
    """Raises InputError, in one sentence, where the pair is not a rest and an indentation image."""
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
    near, far = _disc(rest, press, px_per_mm, 1.2), ~_disc(rest, press, px_per_mm, 3.0)
    if not near.any():
        raise InputError(
            f"the contact is only {2 * press.contact_radius_mm * px_per_mm:.1f} pixels wide; "
            "correct depth_mm or px_per_mm."
        )
    if far.mean() > 0.1:
        likeness = metrics.ncc(rest[far], indentation[far])
        if likeness < MIN_LIKENESS:
            raise InputError(
                f"away from the contact the rest image and the indentation image correlate by only "
                f"{likeness:.2f}; the rest image seems to be of another sensor or session."
            )
    scale = press.contact_radius_mm * px_per_mm / 3
    rows, cols = (np.flatnonzero(near.any(axis)) for axis in (1, 0))
    margin = int(4 * scale)
    around = (
        slice(max(rows[0] - margin, 0), rows[-1] + margin),
        slice(max(cols[0] - margin, 0), cols[-1] + margin),
    )

    def relief(image):  # bumps of the size of the contact; a rest image varies more slowly
        bumps = [gaussian_laplace(image[..., k][around].astype(np.float32), scale) for k in range(3)]
        return float(np.sqrt(np.mean(np.square(np.stack(bumps, -1)[near[around]]))))

    blur = 0.15 * px_per_mm  # averages noise within a grid cell
    difference = gaussian_filter(indentation.astype(np.float32) - rest, (blur, blur, 0))
    there = float(np.sqrt(np.mean(np.square(difference[near]))))
    elsewhere = float(np.sqrt(np.mean(np.square(difference[far])))) if far.any() else 0.0
    if there < max(MIN_CONTRAST * elsewhere, 1.0):
        raise InputError(
            f"the indentation image shows no contact at ({x:.0f}, {y:.0f}) px: its difference to rest is "
            f"{there:.1f} levels there and {elsewhere:.1f} elsewhere; press harder or correct the position."
        )
    if relief(indentation) < relief(rest):
        raise InputError(
            f"the rest image has more relief at ({x:.0f}, {y:.0f}) px than the indentation image; "
            "they seem to be swapped."
        )


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
