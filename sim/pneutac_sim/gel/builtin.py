"""A generated DIGIT: three coloured LEDs around a grey gel, for use where no photograph is at hand."""

import numpy as np

# Light of three LEDs on the sides of the window, in levels per unit slope (rows R, G, B; columns x, y), and
# in levels per millimetre; round numbers of the size that calibration finds on real DIGITs.
LIGHT = np.array([[-110.0, 80.0], [90.0, 30.0], [-30.0, -130.0]])
DEPTH_LIGHT = np.array([-3.0, -8.0, -4.0])
EFFECTS = {"rest_colour": {"exponent_red": 1.0, "exponent_green": 1.0, "exponent_blue": 1.0}}

# Soft glows: channel, centre (x, y) and widths as fractions of width and height, strength in levels.
_AMBIENT = (42.0, 66.0, 74.0)
_GLOWS = (
    (0, 0.20, 0.42, 0.27, 0.32, 125.0),
    (0, 0.12, 0.88, 0.34, 0.22, 40.0),
    (0, 0.45, 0.20, 0.40, 0.10, 40.0),
    (1, 0.85, 0.42, 0.32, 0.30, 88.0),
    (1, 0.10, 0.16, 0.30, 0.10, 50.0),
    (1, 0.55, 0.10, 0.50, 0.14, 25.0),
    (2, 0.15, 0.70, 0.32, 0.28, 55.0),
    (2, 0.60, 0.95, 0.30, 0.20, 55.0),
    (2, 0.50, 0.00, 0.60, 0.08, 35.0),
)


def rest_image(shape: tuple[int, int, int]) -> np.ndarray:
    """Rest image of the generated DIGIT, uint8 of `shape` (H, W, 3)."""
    h, w, _ = shape
    y, x = (np.mgrid[:h, :w] + 0.5) / np.array([h, w])[:, None, None]
    image = np.empty(shape)
    image[:] = _AMBIENT
    for channel, cx, cy, sx, sy, level in _GLOWS:
        image[..., channel] += level * np.exp(-0.5 * (((x - cx) / sx) ** 2 + ((y - cy) / sy) ** 2))
    vignette = 1.0 - 0.14 * ((2 * x - 1) ** 2 + (2 * y - 1) ** 2)
    return np.clip(image * vignette[..., None], 0, 255).round().astype(np.uint8)
