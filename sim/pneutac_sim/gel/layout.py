"""Where the lights of known sensors stand, and which way round a sensor's images are.

One indentation shows from where the light comes at that place, not how far away it stands nor how it spreads.
Sensors of one make share both, so a sensor that is recognised takes the rest from the prior of its model. Its
rest image identifies the sensor model, whatever was pressed; otherwise the directions of the light do.
"""

import base64
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import yaml

from pneutac_sim.effects.near_light import MAKE_SD_MM
from pneutac_sim.effects.rest_colour import MAKE_SD
from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError, unknown_names
from pneutac_sim.files import read_fields, write_text
from pneutac_sim.gel.residual import FEATURES, Leftover, ResidualField, learn, mean

# Of a prior field: a finer or stronger one holds more that is the sensor's own.
CELLS, STRENGTH_LEVELS = 48, 8.0


@dataclass(frozen=True, eq=False)
class SensorPrior:
    """One sensor of a make."""

    # its image without contact as a prior keeps it, (16, 12, 3) levels, by which it is known again
    rest: np.ndarray
    field: ResidualField  # what the model leaves over on it, for a light of strength 1

    @classmethod
    def of(cls, rest: np.ndarray, leftovers: Sequence[Leftover], strength: float) -> "SensorPrior":
        """From what a fit leaves over, of a light of this strength (levels per unit slope)."""
        return cls(rest, learn(leftovers, CELLS, STRENGTH_LEVELS).times(1 / strength))

    @classmethod
    def read(cls, content: dict[str, str], shape: tuple[int, int, int]) -> "SensorPrior":
        """From `written`; the rest image has this shape.

        Raises:
            KeyError, TypeError, ValueError: it is no such thing.
        """
        rest = np.frombuffer(base64.b64decode(content["rest"], validate=True), np.uint8)
        field = np.frombuffer(base64.b64decode(content["field"], validate=True), "<f2")
        field = field.reshape(3, -1, FEATURES + 1).astype(np.float32)
        return cls(
            rest.reshape(shape).astype(np.float32), ResidualField(field[..., :FEATURES], field[..., FEATURES])
        )

    def written(self) -> dict[str, str]:
        """As text: levels as bytes, then z_j and c_j (3, n, 8) as 16-bit floats, in base64."""
        field = np.concatenate([self.field.centres, self.field.weights[..., None]], -1)
        return {
            "rest": base64.b64encode(self.rest.round().astype(np.uint8).tobytes()).decode(),
            "field": base64.b64encode(field.astype("<f2").tobytes()).decode(),
        }


FORMAT = "pneutac-prior-1"
STORED_PX = (12, 16)  # columns and rows of a rest image in a prior's file
MAKE_SD_RAD = 0.05  # spread of the directions of lights between sensors of one model

# Largest angle between the measured and the make's direction of any light.
MATCH_DEG = 25.0
# Least correlation of blurred rest images. Two DIGITs have .87 with each other and .86 and .84 with the
# generated one, .67 at most in any other orientation, and a GelSight .5 with any of them.
LIKE, MARGIN = 0.76, 0.1
LIGHT = ("x_mm", "y_mm", "distance_sd_mm", "direction_sd_rad", "exponent", "exponent_sd")
SAME = 0.95  # that of one unit with itself, upright, whatever else it looks like mirrored
THUMB, BLUR = (24, 32), 2.0  # columns and rows to which they are shrunk, and the blur there


@dataclass(frozen=True)
class Layout:
    """What sensors of one make share, red, green and blue, seen in an upright, unmirrored RGB image."""

    name: str  # of the make
    positions_mm: tuple[tuple[float, float], ...]  # (3, 2), x and y of each light from the window's centre
    exponents: tuple[float, float, float]  # of the rest colour, see the effect `rest_colour`
    proportions: float  # width of the images over their height
    # what such a sensor shows without contact, (16, 12, 3) levels; None where unknown
    rest: np.ndarray | None = field(default=None, compare=False)
    # spread of the lights' distances between sensors
    distances_sd_mm: tuple[float, float, float] = (MAKE_SD_MM,) * 3
    directions_sd_rad: tuple[float, float, float] = (MAKE_SD_RAD,) * 3  # spread of their directions
    exponents_sd: tuple[float, float, float] = (MAKE_SD,) * 3  # spread of the exponents
    # sensors of the make whose residual field is known, seen as the lights are
    units: tuple[SensorPrior, ...] = field(default=(), compare=False)

    @classmethod
    def read(cls, file: Path) -> "Layout":
        """From a file of `write`.

        Raises InputError: one sentence with file, and what is missing or wrong.
        """
        own = ("format", "name", "proportions", *CHANNELS, "rest")
        content = read_fields(file, (*own, "source", "units"), own)
        try:
            for c in CHANNELS:
                for fault in unknown_names(content[c], LIGHT):
                    raise ValueError(f"{c}: {fault}")
            if content["format"] != FORMAT:
                raise ValueError(f"field 'format' is not {FORMAT}")
            channels = [{k: float(v) for k, v in content[c].items()} for c in CHANNELS]
            rest = np.array(content["rest"], np.float32).reshape(STORED_PX[1], STORED_PX[0], 3)
            out = cls(
                str(content["name"]),
                tuple((c["x_mm"], c["y_mm"]) for c in channels),
                tuple(c["exponent"] for c in channels),
                float(content["proportions"]),
                rest,
                tuple(c["distance_sd_mm"] for c in channels),
                tuple(c["direction_sd_rad"] for c in channels),
                tuple(c["exponent_sd"] for c in channels),
                tuple(SensorPrior.read(unit, rest.shape) for unit in content.get("units", ())),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as e:
            raise InputError(
                f"{file} is no prior of a sensor ({type(e).__name__}: {e}); delete it, or save it again with "
                "`pneutac calibrate --save_prior=NAME`."
            ) from e
        spread = (*out.distances_sd_mm, *out.directions_sd_rad, *out.exponents_sd, out.proportions)
        numbers = [*np.ravel(out.positions_mm), *out.exponents, *spread]
        if not np.isfinite(numbers).all() or min(spread) <= 0 or not np.isfinite(rest).all():
            raise InputError(f"{file} holds numbers that no prior has; delete it, or save it again.")
        return out

    def write(self, file: Path, source: str) -> None:
        """As YAML, whole or not at all; `source` names its origin. It must know its rest image."""
        assert self.rest is not None
        content = {"format": FORMAT, "name": self.name, "source": source, "proportions": self.proportions}
        spreads = self.distances_sd_mm, self.directions_sd_rad
        each = zip(
            *zip(*self.positions_mm, strict=True), *spreads, self.exponents, self.exponents_sd, strict=True
        )
        content |= {
            c: dict(zip(LIGHT, values, strict=True)) for c, values in zip(CHANNELS, each, strict=True)
        }
        if self.units:
            content["units"] = [unit.written() for unit in self.units]
        content["rest"] = self.rest.round().astype(int).reshape(STORED_PX[1], -1).tolist()
        write_text(file, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=200))

    def prior_field(self, rest: np.ndarray, orientation: "Orientation") -> ResidualField | None:
        """The mean residual field of other sensors of the make, for a light of strength 1; None if of none.

        A sensor's own is never among them: those are left out whose rest image is its own, uint8 (H, W, 3).
        """
        seen = _blurred(rest)
        others = [u for u in self.units if (seen * _blurred(orientation.shown(u.rest))).sum() <= SAME]
        o = orientation
        return mean([u.field.shown(o.channels, o.mirror_x, o.mirror_y) for u in others]) if others else None


def stored_rest(rest: np.ndarray) -> np.ndarray:
    """A rest image (H, W, 3) as a prior keeps it, (16, 12, 3)."""
    return cv2.resize(rest.astype(np.float32), STORED_PX, interpolation=cv2.INTER_AREA)


# Found on 34 photographs of two DIGITs of unlike brightness; alone they give red (7.0, -6.8) and (8.5, -7.7),
# green (-13.8, -6.3) and (-11.6, -5.0), blue (36, 139) and (10, 77) mm, exponents (1.3, 2.3, 0.4) and
# (1.3, 3.4, 0.3).
DIGIT = Layout.read(Path(__file__).parent / "makes" / "digit.yaml")


@dataclass(frozen=True)
class Orientation:
    """How a sensor's images differ from its make's."""

    # which of the make's lights each of the image's channels shows, e.g. (2, 1, 0) for BGR.
    channels: tuple[int, int, int] = (0, 1, 2)
    mirror_x: bool = False  # left and right swapped
    mirror_y: bool = False  # up and down swapped

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
        spreads = (layout.distances_sd_mm, layout.directions_sd_rad, layout.exponents_sd)
        turned = [tuple(spread[c] for c in self.channels) for spread in spreads]
        return Layout(layout.name, positions, exponents, layout.proportions, None, *turned)

    def shown(self, image: np.ndarray) -> np.ndarray:
        """An image (H, W, 3) of the make as a sensor of this orientation shows it."""
        image = image[..., list(self.channels)]
        image = image[:, ::-1] if self.mirror_x else image
        return image[::-1] if self.mirror_y else image


def orientations() -> list[Orientation]:
    """All orientations, that of the sensor model first."""
    flips = itertools.product((False, True), repeat=2)
    return [Orientation(c, *f) for f in flips for c in itertools.permutations(range(3))]


def recognise_rest(rest: np.ndarray, layout: Layout = DIGIT) -> tuple[Orientation | None, float]:
    """Which way round a sensor's images are, if its rest image, uint8 (H, W, 3), is of this make.

    Returns the orientation, None where it is not of this make or could be two ways round, and the correlation
    of the blurred images in the best one.
    """
    if layout.rest is None or not _proportioned(rest.shape[1::-1], layout):
        return None, 0.0
    seen, own = _blurred(rest), cv2.resize(layout.rest, THUMB, interpolation=cv2.INTER_LINEAR)
    likeness = [float((seen * _blurred(o.shown(own))).sum()) for o in orientations()]
    if likeness[0] > SAME:  # orientations() has the make's own first
        return Orientation(), likeness[0]
    best, second = np.sort(likeness)[:-3:-1]
    found = orientations()[int(np.argmax(likeness))]
    return (found if best > LIKE and best > second + MARGIN else None), float(best)


def _blurred(image: np.ndarray) -> np.ndarray:
    image = np.ascontiguousarray(image, np.float32)
    small = image if image.shape[1::-1] == THUMB else cv2.resize(image, THUMB, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), BLUR)
    small -= small.mean()
    return small / max(float(np.linalg.norm(small)), 1e-9)


def _proportioned(image_size: tuple[int, ...], layout: Layout) -> bool:
    return abs(image_size[0] / image_size[1] / layout.proportions - 1) <= 0.05


def recognise(
    light: np.ndarray, x_mm: float, y_mm: float, image_size: tuple[int, int], layout: Layout = DIGIT
) -> Orientation | None:
    """Which way round a sensor's images are, by the light of one press; None if not of this make.

    L (3, 2) was fitted to an indentation at (x, y) mm from the window's centre; the light comes from -L. The
    make's own orientation is taken where it fits, since mirrored images with two channels swapped may fit
    about as well; else the one that fits best.
    """
    if not _proportioned(image_size, layout):
        return None

    def mismatch(orientation: Orientation) -> float:
        towards = np.array(orientation.of(layout).positions_mm) - (x_mm, y_mm)
        angles = np.arctan2(towards[:, 1], towards[:, 0]) - np.arctan2(-light[:, 1], -light[:, 0])
        return float(np.degrees(np.abs((angles + np.pi) % (2 * np.pi) - np.pi)).max())

    every = orientations()
    best = every[0] if mismatch(every[0]) < MATCH_DEG else min(every, key=mismatch)
    return best if mismatch(best) < MATCH_DEG else None
