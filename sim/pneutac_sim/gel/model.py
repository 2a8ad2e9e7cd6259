"""The gel as its twin keeps it: sizes, mechanics and light of one camera-based touch sensor.

A generated DIGIT: three coloured LEDs around a grey gel, for use where no photograph is at hand.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

import cv2
import numpy as np
from PIL import Image

from pneutac_sim.effects.registry import get_effect, in_order, of_body, of_sensor
from pneutac_sim.effects.sensor_effect import SensorEffect
from pneutac_sim.errors import InputError, finite_array, option, unknown_names
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel import optics
from pneutac_sim.gel.contact import THRESHOLD_LEVELS
from pneutac_sim.gel.probe import COLS, ROWS, THICKNESS_MM
from pneutac_sim.gel.residual import LEAST_WEIGHT, ResidualField, levels
from pneutac_sim.gel.surface import DECAY_MM
from pneutac_sim.twin import GEL, Twin, Value

LEAST_PX = 32  # a side of the image
FIELDS = ("prior_residual", "residual")
EARLIER = "lent"  # what the first one was called in twins of earlier versions
OWN_PLACE = ("rest_image", "effects", *FIELDS)  # in a twin, not among the gel's numbers


@dataclass
class GelModel:
    """One sensor: c = c0 + w s, s = L grad u + c_d u, with u the surface displacement (paper, Sec. III-B).

    Effects of the stages `gel` and `light` bend that, see `effects.sensor_effect`.
    """

    rest_image: np.ndarray  # c0, the image without contact, uint8 (H, W, 3)
    light: np.ndarray  # L, levels per unit slope, one row each for R, G, B; columns along x and y
    depth_light: np.ndarray  # c_d, levels per millimetre of displacement, R, G, B
    px_per_mm: float = 20.0  # scale of the rest image
    thickness_mm: float = THICKNESS_MM  # gel thickness, the largest depth
    decay_mm: float = DECAY_MM  # length over which the surface recovers around a contact
    # how deep an imprint the camera sees is over how deep the object lies below the resting surface, up to 1;
    # the skin over a gel bridges the edge of a contact
    depth_scale: float = 1.0
    # difference to the rest image above which a pixel counts as contact
    threshold_levels: float = THRESHOLD_LEVELS
    # of the sensor, name to parameters; without any this is the paper's linear model
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    # residual field from other sensors of the make, scaled as it was taken, or None
    prior_residual: ResidualField | None = None
    residual: ResidualField | None = None  # field learnt from several presses besides that, or None

    def __post_init__(self):
        image = self.rest_image
        if getattr(image, "dtype", None) != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise InputError("The gel's rest_image must be RGB, 8 bits a channel, height x width x 3.")
        for name, shape in (("light", (3, 2)), ("depth_light", (3,))):
            setattr(self, name, finite_array(f"The gel's {name}", getattr(self, name), shape).copy())
        for name in ("px_per_mm", "thickness_mm", "decay_mm", "depth_scale", "threshold_levels"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
                raise InputError(f"The gel's {name} is {value!r}; it must be a positive number.")

        if self.depth_scale > 1:
            raise InputError(f"The gel's depth_scale is {self.depth_scale!r}; it must not exceed 1.")
        for name, values in self.effects.items():
            specs = {p.name: p for p in get_effect(name).parameters}
            for parameter, value in values.items():
                p = specs.get(parameter)
                if p is not None and not p.lower <= value <= p.upper:
                    raise InputError(
                        f"The gel's effect '{name}' has {parameter} = {value!r}; it must lie between "
                        f"{p.lower:g} and {p.upper:g}."
                    )
            if set(values) != set(specs):
                missing, extra = set(specs) - set(values), set(values) - set(specs)
                what = (
                    f"lacks {', '.join(sorted(missing))}" if missing else f"has no {', '.join(sorted(extra))}"
                )
                raise InputError(f"The gel's effect '{name}' {what}; it takes {', '.join(specs)}.")

    @property
    def window_mm(self) -> tuple[float, float]:
        """Width and height of the visible gel."""
        h, w = self.rest_image.shape[:2]
        return w / self.px_per_mm, h / self.px_per_mm

    @property
    def cell_mm(self) -> tuple[float, float]:
        """Spacing of the probe grid along x and y."""
        return self.window_mm[0] / COLS, self.window_mm[1] / ROWS

    @property
    def acting(self) -> list[tuple[SensorEffect, dict[str, float]]]:
        """Its effects with their values, in the order in which they act."""
        return [(e, self.effects[e.name]) for e in in_order(self.effects)]

    @property
    def weight(self) -> np.ndarray:
        """The surface weight w, (H, W, 3) float32."""
        return self.weight_on(self.rest_image)

    def weight_on(self, rest: np.ndarray) -> np.ndarray:
        """The surface weight on any rest image (rows, columns, 3), float32; black counts as one level."""
        out = np.ones(rest.shape, np.float32)
        factors = [(e, v) for e, v in self.acting if e.weight is not None]
        if factors:
            bright = np.maximum(rest, 1.0)
            log_rest = np.log((bright / bright.mean((0, 1))).astype(np.float64))
        for effect, values in factors:
            for k in range(3):
                out[..., k] *= effect.weight(log_rest[..., k], effect.channel_values(values, k))
        return out

    @property
    def coefficients(self) -> np.ndarray:
        """What `optics.light` takes, (3, 12)."""
        direction = -self.light / np.maximum(np.linalg.norm(self.light, axis=1), 1e-9)[:, None]
        acting = [[(e, e.channel_values(v, k)) for e, v in self.acting] for k in range(3)]
        each = zip(self.light, self.depth_light, direction, acting, strict=True)
        return np.stack([optics.row(*channel) for channel in each])

    @property
    def further(self) -> list[optics.Further]:
        """What effects outside the compiled light make of it, see `optics.light`."""
        acting = [(e, v) for e, v in self.acting if e.light]
        return [further_light(e, lambda k, e=e, v=v: e.channel_values(v, k)) for e, v in acting]

    @property
    def field_share(self) -> np.ndarray:
        """What residual fields are multiplied by on the probe grid, since w is about to multiply them."""
        w = self.weight_on(cv2.resize(self.rest_image, (COLS, ROWS), interpolation=cv2.INTER_AREA))
        return 1 / np.maximum(w, LEAST_WEIGHT).transpose(2, 0, 1)

    @property
    def lighting(self) -> tuple[np.ndarray, list[optics.Further], optics.ResidualLight | None]:
        """What `optics.light` takes after a surface and its grid's spacing."""
        learnt = [f for f in (self.prior_residual, self.residual) if f is not None]
        if not learnt:
            return self.coefficients, self.further, None
        share = self.field_share
        residual_light = lambda u, cell_mm, shadows: share * levels(learnt, u, cell_mm, shadows)  # noqa: E731
        return self.coefficients, self.further, residual_light

    def surface(self, displacement_mm: np.ndarray, cell_mm: tuple[float, float]) -> np.ndarray:
        """The displacement (80, 59) in mm as effects of the gel change it."""
        for effect, values in self.acting:
            if effect.surface is not None:
                displacement_mm = np.asarray(effect.surface(displacement_mm, cell_mm, values), np.float32)
        return displacement_mm

    def imprint(self, depth_mm: np.ndarray) -> np.ndarray:
        """Probe grid of what the camera sees pressed in, float32: the object drawn back by the skin."""
        if self.depth_scale == 1 or not depth_mm.any():
            return np.asarray(depth_mm, np.float32)
        return np.maximum(depth_mm - np.float32((1 - self.depth_scale) * depth_mm.max()), 0)

    def resized(self, height: int, width: int) -> "GelModel":
        """The same gel seen by an image of another size but the same proportions (within 2 %).

        Raises InputError: the proportions differ, or there would be no pixels left.
        """
        if min(height, width) < LEAST_PX:
            raise InputError(f"An image of {width} x {height} px is too small; give {LEAST_PX} px or more.")
        h, w = self.rest_image.shape[:2]
        if abs(w / h / (width / height) - 1) > 0.02:
            raise InputError(
                f"The gel's images are {w} x {h} pixels, which cannot become {width} x {height} without "
                "distortion; give a size of the same proportions, or crop the images."
            )
        image = np.asarray(Image.fromarray(self.rest_image).resize((width, height), Image.Resampling.BOX))
        return replace(self, rest_image=image, px_per_mm=self.px_per_mm * height / h)

    @classmethod
    def builtin(cls) -> "GelModel":
        """A generated DIGIT."""
        effects = {name: dict(values) for name, values in EFFECTS.items()}
        return cls(rest_image(IMAGE_SHAPE), LIGHT, DEPTH_LIGHT, effects=effects)

    @classmethod
    def from_twin(cls, twin: Twin | None) -> "GelModel":
        """The twin's gel; the generated DIGIT where the twin has none.

        Raises InputError: a field of the twin's gel is missing, unknown or malformed.
        """
        if twin is None or not twin.gel:
            return cls.builtin()
        if "rest_image" not in twin.arrays:
            raise InputError("The twin's gel has no array 'rest_image'; calibrate the gel again.")
        for name in of_body(twin.effects) if twin.device == "gel" else ():
            raise InputError(f"The twin is of a gel, on which its effect '{name}' does not act; take it out.")
        for fault in unknown_names(twin.gel, GEL):
            raise InputError(f"The twin's gel: {fault}")
        missing = [name for name in GEL if name not in twin.gel]
        if missing:
            raise InputError(
                f"The twin's gel lacks {', '.join(missing)}; `pneutac calibrate "
                f"{option('twin', twin.folder or 'FOLDER')} --recording=DIR` of a gel's presses finds them."
            )
        effects = {n: {k: v.value for k, v in twin.effects[n].items()} for n in of_sensor(twin.effects)}
        learnt = {
            FIELDS[0] if name == EARLIER else name: ResidualField(*(twin.arrays[a] for a in _arrays(name)))
            for name in (EARLIER, *FIELDS)
            if set(_arrays(name)) <= set(twin.arrays)
        }
        return cls(twin.arrays["rest_image"], **twin.gel, effects=effects, **learnt)

    def into_twin(self, twin: Twin) -> None:
        """Writes this gel into a twin (of a gel, or of a finger that carries one)."""
        own = {k: v for k, v in asdict(self).items() if k not in OWN_PLACE}
        before = of_sensor(twin.effects)
        twin.effects = {k: v for k, v in twin.effects.items() if k not in before}
        twin.effects |= {n: {k: Value(float(v)) for k, v in e.items()} for n, e in self.effects.items()}
        twin.gel = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in own.items()}
        twin.arrays["rest_image"] = self.rest_image.copy()
        for name in (EARLIER, *FIELDS):
            centres, weights = _arrays(name)
            learnt = getattr(self, name, None)
            twin.arrays = {k: v for k, v in twin.arrays.items() if k not in (centres, weights)}
            if learnt is not None:
                twin.arrays |= {centres: learnt.centres, weights: learnt.weights}


def _arrays(name: str) -> tuple[str, str]:
    return f"{name}_centres", f"{name}_weights"


def further_light(effect: SensorEffect, values: Callable[[int], dict[str, float]]) -> optics.Further:
    """An effect's hook `light` as `optics.light` takes it; `values` gives those of a channel."""

    def change(k, s, u, cell_mm):
        return effect.light(s, u, cell_mm, values(k))

    return change


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
