"""Where the lights of known sensors stand, and which way round a sensor's images are.

One indentation tells from where the light comes at that place, not how far away it stands nor how it spreads.
Sensors of one make share both, so a sensor that is recognised by the directions of its light lends the rest
from its make.
"""

import itertools
from dataclasses import dataclass

import numpy as np

# Largest angle between the measured and the make's direction of any light.
MATCH_DEG = 25.0


@dataclass(frozen=True)
class Layout:
    """Lights of one make of sensor, red, green and blue, seen in an upright, unmirrored RGB image.

    Attributes:
        name: of the make.
        positions_mm: (3, 2), x and y of each light from the window's centre.
        exponents: of the rest colour, see the effect `rest_colour`.
        proportions: width of the images over their height.
    """

    name: str
    positions_mm: tuple[tuple[float, float], ...]
    exponents: tuple[float, float, float]
    proportions: float


# Found on 34 photographs of two DIGITs of unlike brightness; alone they give red (7.0, -6.8) and (8.5, -7.7),
# green (-13.8, -6.3) and (-11.6, -5.0), blue (36, 139) and (10, 77) mm, exponents (1.3, 2.3, 0.4) and
# (1.3, 3.4, 0.3).
DIGIT = Layout("DIGIT", ((7.75, -7.2), (-12.7, -5.6), (22.0, 107.0)), (1.3, 2.4, 0.4), 0.75)


@dataclass(frozen=True)
class Orientation:
    """How a sensor's images differ from its make's.

    Attributes:
        channels: which of the make's lights each of the image's channels shows, e.g. (2, 1, 0) for BGR.
        mirror_x: left and right swapped.
        mirror_y: up and down swapped.
    """

    channels: tuple[int, int, int] = (0, 1, 2)
    mirror_x: bool = False
    mirror_y: bool = False

    def __str__(self):
        order = "".join("RGB"[c] for c in self.channels)
        how = [f"channels {order} instead of RGB"] if order != "RGB" else []
        if self.mirror_x and self.mirror_y:
            how.append("turned upside down")
        elif self.mirror_x or self.mirror_y:
            how.append("mirrored left to right" if self.mirror_x else "mirrored top to bottom")
        return " and ".join(how) or "upright RGB"

    def of(self, layout: Layout) -> Layout:
        """The layout as images of this orientation show it."""
        flip = np.array([-1.0 if self.mirror_x else 1.0, -1.0 if self.mirror_y else 1.0])
        positions = tuple(tuple(flip * layout.positions_mm[c]) for c in self.channels)
        exponents = tuple(layout.exponents[c] for c in self.channels)
        return Layout(layout.name, positions, exponents, layout.proportions)


def recognise(
    light: np.ndarray, x_mm: float, y_mm: float, image_size: tuple[int, int], layout: Layout = DIGIT
) -> Orientation | None:
    """Which way round a sensor's images are, if it may be of this make.

    Args:
        light: L (3, 2) fitted to one indentation; the light comes from -L.
        x_mm: where that indentation is, from the window's centre.
        y_mm: along image rows.
        image_size: width and height of the images.
        layout: the make.

    Returns:
        The make's own orientation where it fits, since mirrored images with two channels swapped may fit
        about as well; else the one that fits best; None where the directions or the proportions of the images
        are not the make's.
    """
    if abs(image_size[0] / image_size[1] / layout.proportions - 1) > 0.05:
        return None

    def mismatch(orientation: Orientation) -> float:
        towards = np.array(orientation.of(layout).positions_mm) - (x_mm, y_mm)
        angles = np.arctan2(towards[:, 1], towards[:, 0]) - np.arctan2(-light[:, 1], -light[:, 0])
        return float(np.degrees(np.abs((angles + np.pi) % (2 * np.pi) - np.pi)).max())

    flips = itertools.product((False, True), repeat=2)
    every = [Orientation(c, *f) for f in flips for c in itertools.permutations(range(3))]
    best = every[0] if mismatch(every[0]) < MATCH_DEG else min(every, key=mismatch)
    return best if mismatch(best) < MATCH_DEG else None
