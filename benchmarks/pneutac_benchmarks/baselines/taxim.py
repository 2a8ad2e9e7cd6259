"""Taxim (Si and Yuan, RA-L 2022): colours looked up by surface normal, with shadows learnt from examples.

As in the paper and its released code: the gel takes the indenter's shape and is blurred by a pyramid of
Gaussians outside the contact; normals are sorted by slope and direction into a table of 125 x 125 bins; each
bin holds a polynomial of second order in image position for the change of each colour; empty bins take the
nearest filled one; shadows are rays of darkening, by direction and distance from the contact's edge.

The released calibration has about 50 images of a ball and, for shadows, of a pin. From one image:

- A bin sees the few pixels of one place, which cannot tell how its colour depends on position. Least squares
  per bin therefore have a ridge towards a constant, and bins with few pixels take in their neighbours'.
- The table is filled from the whole image under the approximated surface, not from the inside of the contact
  alone. Else flat gel takes the colour of the ball's lowest point: on a DIGIT with cast shadows that costs an
  error of 13.9 levels against 9.0.
- Changes are added to the rest image itself: the smoothed one, which hides markers, has a larger error here.
- Shadows are what the image is darker than the table along each ray; one image has one depth, so lengths are
  taken to grow in proportion to it.
"""

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from pneutac_benchmarks.baselines.pair import Pair
from pneutac_sim.gel.indenter import Press

BINS = 125  # of slope, 0 to 90 degrees, and of direction, all round
PYRAMID_PX = (201, 101, 51, 21, 11, 5)  # blur kernels, at the scale of the released sensor
PYRAMID_PX_PER_MM = 1 / 0.0295
CONTACT_SHARE = 0.4  # of the depth, above which the gel keeps the indenter's shape
SMOOTH_PX = 2.0  # final blur of changes and of shadows, at the scale of the released sensor

RIDGE = 1.0  # against the position's coefficients, for each pixel of a bin; positions run from -1 to 1
FEW_PIXELS = 10  # in a bin, below which it takes in its neighbours
POOL_BINS = 2.0  # reach of that

SHADOW_DIRECTIONS = 63  # 0.1 rad, as released
SHADOW_REACH_MM = 4.4
SHADOW_STEP_PX = 1.25
SHADOW_LEVELS = -5.0  # darker than the table by this much, else the shadow has ended
FAN_RAD = (-0.1, -0.05, 0.0, 0.05, 0.1)  # rays beside each ray that its shadow also falls on


class Taxim:
    """Lookup table of colour changes by surface normal, and of shadows by direction."""

    def __init__(self, rest: np.ndarray, px_per_mm: float, thickness_mm: float):
        self._rest, self._px_per_mm, self._thickness_mm = rest, px_per_mm, thickness_mm
        self._smooth_px = SMOOTH_PX * px_per_mm / PYRAMID_PX_PER_MM
        self._positions = _positions(*rest.shape[:2])

    @classmethod
    def fit(cls, pair: Pair) -> "Taxim":
        """Fills both tables."""
        model = cls(pair.rest, pair.px_per_mm, pair.thickness_mm)
        height, contact = model._surface(pair.press)
        change = pair.image.astype(np.float64) - pair.rest
        model._table = _fit_table(_bins(height, pair.px_per_mm), model._positions, change)
        darker = gaussian_filter(change - model._looked_up(height), (model._smooth_px, model._smooth_px, 0))
        rays = _Rays(height, contact)
        model._shadows = rays.profiles(darker, int(SHADOW_REACH_MM * pair.px_per_mm / SHADOW_STEP_PX))
        model._shadow_depth_mm = pair.press.depth_mm
        return model

    def image(self, press: Press) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3)."""
        height, contact = self._surface(press)
        shadow = _Rays(height, contact).cast(self._shadows, press.depth_mm / self._shadow_depth_mm)
        shadow[contact] = 0
        change = gaussian_filter(self._looked_up(height) + shadow, (self._smooth_px, self._smooth_px, 0))
        return np.clip(self._rest + change, 0, 255).round().astype(np.uint8)

    def _surface(self, press: Press) -> tuple[np.ndarray, np.ndarray]:
        """Depth of the approximated surface [mm] and where it keeps the indenter's shape, both (H, W)."""
        h, w = self._rest.shape[:2]
        depth = press.depths((w / self._px_per_mm, h / self._px_per_mm), self._thickness_mm, (h, w))
        contact = depth > CONTACT_SHARE * depth.max()
        height = depth.copy()
        for kernel in PYRAMID_PX:
            height = _blur(height, kernel, self._px_per_mm)
            height[contact] = depth[contact]
        return _blur(height, PYRAMID_PX[-1], self._px_per_mm), contact

    def _looked_up(self, height_mm: np.ndarray) -> np.ndarray:
        """Colour changes (H, W, 3) of a surface, in levels."""
        return np.einsum("hwp,hwpc->hwc", self._positions, self._table[_bins(height_mm, self._px_per_mm)])


def _blur(image: np.ndarray, kernel_px: int, px_per_mm: float) -> np.ndarray:
    size = max(3, round(kernel_px * px_per_mm / PYRAMID_PX_PER_MM) // 2 * 2 + 1)
    return cv2.GaussianBlur(image, (size, size), 0)


def _bins(height_mm: np.ndarray, px_per_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Bins (H, W) of slope angle and of direction."""
    gy, gx = np.gradient(height_mm, 1 / px_per_mm)
    slope = np.arctan(np.hypot(gx, gy)) / (np.pi / 2) * (BINS - 1)
    direction = (np.arctan2(gy, gx) + np.pi) / (2 * np.pi) * BINS
    return slope.astype(int), direction.astype(int) % BINS


def _positions(height: int, width: int) -> np.ndarray:
    """Polynomial basis x^2, y^2, xy, x, y, 1 of pixel positions in -1 to 1, (H, W, 6)."""
    y, x = np.mgrid[:height, :width]
    x, y = 2 * x / width - 1, 2 * y / height - 1
    return np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], -1)


def _fit_table(bins: tuple[np.ndarray, np.ndarray], positions: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Polynomials of every bin (slopes, directions, 6, 3) by least squares with a ridge."""
    index = (bins[0] * BINS + bins[1]).ravel()
    P, v = positions.reshape(-1, 6), change.reshape(-1, 3)

    def total(values):  # of the pixels of each bin
        return np.bincount(index, values, BINS * BINS).reshape(BINS, BINS)

    PP = np.stack([np.stack([total(P[:, p] * P[:, q]) for q in range(6)], -1) for p in range(6)], -1)
    Pv = np.stack([np.stack([total(P[:, p] * v[:, k]) for k in range(3)], -1) for p in range(6)], -2)
    pixels = total(np.ones(len(v)))[..., None, None]
    share = np.minimum(pixels, FEW_PIXELS) / np.maximum(pixels, 1)  # keeps crowded bins from drowning others
    few = pixels < FEW_PIXELS
    PP, Pv = (np.where(few, _pooled(a * share), a) for a in (PP, Pv))
    pixels = PP[..., -1:, -1:]
    filled = pixels[..., 0, 0] > 0.01
    ridge = np.diag([RIDGE] * 5 + [0.0]) * pixels + 1e-9 * np.eye(6)  # the latter lets empty bins be solved
    table = np.linalg.solve(PP + ridge, Pv)
    # nearest filled bin, with directions going round
    nearest = distance_transform_edt(~np.tile(filled, (1, 3)), return_distances=False, return_indices=True)[
        :, :, BINS : 2 * BINS
    ]
    return table[nearest[0], nearest[1] % BINS]


def _pooled(sums: np.ndarray) -> np.ndarray:
    """Each bin's sums and, falling off with distance, those of its neighbours; directions go round."""
    mode = ("nearest", "wrap", "nearest", "nearest")
    return 2 * np.pi * POOL_BINS**2 * gaussian_filter(sums, (POOL_BINS, POOL_BINS, 0, 0), mode=mode)


class _Rays:
    """Rays from the pixels around a contact, outwards, towards lesser depth."""

    def __init__(self, height_mm: np.ndarray, contact: np.ndarray):
        self._shape = contact.shape
        around = cv2.dilate(contact.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~contact
        self._y, self._x = np.nonzero(around)
        gy, gx = np.gradient(height_mm)
        self._angle = np.arctan2(-gy[around], -gx[around])
        self._direction = ((self._angle + np.pi) / (2 * np.pi) * SHADOW_DIRECTIONS).astype(int)
        self._direction %= SHADOW_DIRECTIONS

    def _at(self, distance_px: float, turn_rad: float) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        """Pixels (rows, columns) on the rays, and the directions of those rays that are in the image."""
        angle = self._angle + turn_rad
        y = np.rint(self._y + distance_px * np.sin(angle)).astype(int)
        x = np.rint(self._x + distance_px * np.cos(angle)).astype(int)
        inside = (y >= 0) & (y < self._shape[0]) & (x >= 0) & (x < self._shape[1])
        return (y[inside], x[inside]), self._direction[inside]

    def profiles(self, darker: np.ndarray, steps: int) -> np.ndarray:
        """Shadows (directions, steps, 3) in levels, zero from where a ray is no longer dark.

        Args:
            darker: image less what the table explains, (H, W, 3), levels.
            steps: length of the profiles.
        """
        total, count = np.zeros((SHADOW_DIRECTIONS, steps, 3)), np.zeros((SHADOW_DIRECTIONS, steps, 1))
        for s in range(steps):
            pixels, direction = self._at(SHADOW_STEP_PX * (s + 1), 0.0)
            np.add.at(total[:, s], direction, darker[pixels])
            np.add.at(count[:, s], direction, 1)
        profile = total / np.maximum(count, 1)
        return np.where(np.logical_and.accumulate(profile < SHADOW_LEVELS, axis=1), profile, 0.0)

    def cast(self, profiles: np.ndarray, stretch: float) -> np.ndarray:
        """Darkening (H, W, 3) in levels: where rays cross, the darkest counts."""
        out = np.zeros((*self._shape, 3))
        for s in np.flatnonzero(profiles.any((0, 2))):
            for turn in FAN_RAD:
                pixels, direction = self._at(SHADOW_STEP_PX * (s + 1) * stretch, turn)
                np.minimum.at(out, pixels, profiles[direction, s])
        return out
