"""A domed gel with a coated face, pressed by rigid objects and looked at from behind."""

import cv2
import numpy as np

from pneutac_truths.light.contact import HalfSpace
from pneutac_truths.light.objects import reach_below
from pneutac_truths.light.rays import Lamps, light


class Gel:
    """One sensor.

    Its face bulges by a large radius, so a plane meets it as a ball does (Hertz 1882; Johnson, Contact
    Mechanics (1985) ch. 4).

    Attributes:
        rest_image: uint8 (H, W, 3) without contact.
        rest_mm: (rows, columns) height of the resting face over x (columns,) and y (rows,), `xs_mm`, `ys_mm`.
    """

    shape = (64, 48)  # rows and columns of contact and light

    def __init__(
        self,
        image_shape: tuple[int, int, int] = (320, 240, 3),
        window_mm: tuple[float, float] = (12.0, 16.0),
        modulus_kpa: float = 130.0,
        dome_mm: float = 35.0,
        lamps: Lamps | None = None,
    ):
        """A gel at rest.

        Args:
            image_shape: height, width and channels of its picture.
            window_mm: width and height of what the camera sees.
            modulus_kpa: E / (1 - nu^2).
            dome_mm: radius of the bulging face.
            lamps: default those of this sensor.
        """
        rows, columns = self.shape
        self._size, self.modulus_kpa, self.dome_mm = image_shape[1::-1], modulus_kpa, dome_mm
        cell = window_mm[0] / columns, window_mm[1] / rows
        self.xs_mm, self.ys_mm = (
            (np.arange(n) + 0.5 - n / 2) * c for n, c in zip((columns, rows), cell, strict=True)
        )
        self.rest_mm = -(self.xs_mm[None, :] ** 2 + self.ys_mm[:, None] ** 2) / (2 * dome_mm)
        self._body = HalfSpace(modulus_kpa, cell, self.shape)
        self._lamps = lamps or Lamps()
        self._paint = _uneven(image_shape)
        self.rest_image = self.image(np.zeros(self.shape))

    def press(self, kinds, sizes_mm, places_mm, turns, left_mm=0.0) -> tuple[np.ndarray, float]:
        """Displacement (rows, columns) of the face in mm and the force in N, see `objects.reach_below`.

        Args:
            kinds: of the objects.
            sizes_mm: of each.
            places_mm: of each.
            turns: of each.
            left_mm: (rows, columns) displacement that is left of what came before.
        """
        reach = reach_below(kinds, sizes_mm, places_mm, turns, self.xs_mm, self.ys_mm)
        moved, force = self._body.press(reach + self.rest_mm - left_mm)
        return left_mm + moved, force

    def image(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Picture uint8 (H, W, 3) of a displaced face."""
        levels = light(self.rest_mm - displacement_mm, self.xs_mm, self.ys_mm, self._lamps)
        large = cv2.resize(levels, self._size, interpolation=cv2.INTER_CUBIC)
        return np.clip(large * self._paint, 0, 255).round().astype(np.uint8)

    def force_n(self, depth_mm: float) -> float:
        """Force of a plane that is pressed in by a depth: 4/3 E* sqrt(R d^3), Hertz."""
        return 4 / 3 * 1e-3 * self.modulus_kpa * np.sqrt(self.dome_mm * max(depth_mm, 0.0) ** 3)


def _uneven(shape: tuple[int, int, int]) -> np.ndarray:
    """(H, W, 1) how much the coat reflects over its mean: blotches of about a millimetre."""
    h, w, _ = shape
    blotches = cv2.GaussianBlur(np.random.default_rng(7).standard_normal((h, w)), (0, 0), 12.0)
    return (1 + 0.02 * blotches / blotches.std())[..., None]
