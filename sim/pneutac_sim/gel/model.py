"""The gel as its twin keeps it: sizes, mechanics and light of one camera-based touch sensor."""

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
from PIL import Image

from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel import builtin
from pneutac_sim.gel.contact import THRESHOLD_LEVELS
from pneutac_sim.gel.probe import THICKNESS_MM
from pneutac_sim.gel.surface import DECAY_MM
from pneutac_sim.twin import Twin


@dataclass
class GelModel:
    """One sensor: c = c0 + w (L grad u + c_d u), with u the surface displacement (paper, Sec. III-B).

    Attributes:
        rest_image: c0, the image without contact, uint8 (H, W, 3).
        light: L, levels per unit slope, one row each for R, G, B; columns along x and y.
        depth_light: c_d, levels per millimetre of displacement, R, G, B.
        px_per_mm: scale of the rest image.
        thickness_mm: gel thickness, the largest depth.
        decay_mm: length over which the surface recovers around a contact.
        multiply: whether w is the rest colour of the pixel over its mean (a gel lights up where light falls)
            instead of 1.
        threshold_levels: difference to the rest image above which a pixel counts as contact.
    """

    rest_image: np.ndarray
    light: np.ndarray
    depth_light: np.ndarray
    px_per_mm: float = 20.0
    thickness_mm: float = THICKNESS_MM
    decay_mm: float = DECAY_MM
    multiply: bool = True
    threshold_levels: float = THRESHOLD_LEVELS

    def __post_init__(self):
        image = self.rest_image
        if getattr(image, "dtype", None) != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise InputError("The gel's rest_image must be RGB, 8 bits a channel, height x width x 3.")
        for name, shape in (("light", (3, 2)), ("depth_light", (3,))):
            try:
                value = np.array(getattr(self, name), np.float64)
            except (TypeError, ValueError):
                value = np.full(1, np.nan)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"The gel's {name} must be finite numbers of shape {shape}.")
            setattr(self, name, value)
        for name in ("px_per_mm", "thickness_mm", "decay_mm", "threshold_levels"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
                raise InputError(f"The gel's {name} is {value!r}; it must be a positive number.")

    @property
    def window_mm(self) -> tuple[float, float]:
        """Width and height of the visible gel."""
        h, w = self.rest_image.shape[:2]
        return w / self.px_per_mm, h / self.px_per_mm

    @property
    def weight(self) -> np.ndarray:
        """The surface weight w, (H, W, 3) float32."""
        if not self.multiply:
            return np.ones(self.rest_image.shape, np.float32)
        return (self.rest_image / self.rest_image.mean((0, 1))).astype(np.float32)

    def resized(self, height: int, width: int) -> "GelModel":
        """The same gel seen by an image of another size but the same proportions (within 2 %).

        Raises:
            InputError: the proportions differ.
        """
        h, w = self.rest_image.shape[:2]
        if abs(w / h / (width / height) - 1) > 0.02:
            raise InputError(
                f"The gel's images are {w} x {h} pixels, which cannot become {width} x {height} without "
                "distortion; crop the recording's images to 3 : 4."
            )
        image = np.asarray(Image.fromarray(self.rest_image).resize((width, height), Image.Resampling.BOX))
        return replace(self, rest_image=image, px_per_mm=self.px_per_mm * height / h)

    @classmethod
    def builtin(cls) -> "GelModel":
        """A generated DIGIT."""
        return cls(builtin.rest_image(IMAGE_SHAPE), builtin.LIGHT, builtin.DEPTH_LIGHT)

    @classmethod
    def from_twin(cls, twin: Twin | None) -> "GelModel":
        """The twin's gel; the generated DIGIT where the twin has none.

        Raises:
            InputError: a field of the twin's gel is missing, unknown or malformed.
        """
        if twin is None or not twin.gel:
            return cls.builtin()
        if "rest_image" not in twin.arrays:
            raise InputError("The twin's gel has no array 'rest_image'; calibrate the gel anew.")
        try:
            return cls(rest_image=twin.arrays["rest_image"], **twin.gel)
        except TypeError as e:
            raise InputError(f"The twin's gel has a field too many or too few: {e}.") from e

    def into_twin(self, twin: Twin) -> None:
        """Writes this gel into a twin (of a gel, or of a finger that carries one)."""
        fields = {k: v for k, v in asdict(self).items() if k != "rest_image"}
        twin.gel = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in fields.items()}
        twin.arrays["rest_image"] = self.rest_image.copy()
