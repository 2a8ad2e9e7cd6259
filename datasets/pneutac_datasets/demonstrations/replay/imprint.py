"""What images show besides the contact area: the strength of an imprint, and the drift of the light."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_sim.gel.contact import THRESHOLD_LEVELS
from pneutac_sim.gel.sensor import TactileSensor, centre_mm

REST_FRAMES, GAP = 12, 1  # frames before the first touch that show the gel at rest, but for the last ones
DRIFT_LEVELS, SHAPE_LEVELS = 2.0, 2.0  # of a rest image: less is noise, rounding and slow wander of a camera
FAINT_LEVELS = 5.0  # what noise changes
APART = 4  # pixels whose brightness is measured
CENTRE_REST_FRAMES, LEAST_PIXELS = 8, 50  # of an imprint's middle: frames at rest, smallest imprint
LEAST_SHOWN = 0.02  # levels over the image, below which an imprint has no direction


def rest_image(episode: Episode) -> np.ndarray:
    """The gel at rest in an episode, uint8 (H, W, 3): the mean of the frames before its first touch."""
    contact = episode.contact()
    until = len(episode) if contact is None else max(contact[0] - GAP, 1)
    frames = episode.images[max(until - REST_FRAMES, 0) : until]
    return frames.mean(0).round().astype(np.uint8)


def areas(images: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Contact areas (T,) of images uint8 (T, H, W, 3) against a rest image, without isolated noise pixels."""
    out = np.empty(len(images))
    for t, image in enumerate(images):
        change = cv2.blur(cv2.absdiff(image, rest), (3, 3)).sum(2, dtype=np.float32) / 3
        out[t] = float((change > THRESHOLD_LEVELS).mean())
    return out


def imprint_centres_mm(images: np.ndarray, area: np.ndarray, sensor: TactileSensor) -> np.ndarray:
    """Middle of the imprint in each image (T, 2), mm across and along the finger; NaN without touch.

    Args:
        images: uint8 (T, H, W, 3) of one demonstration; those before its first touch show the gel at rest.
        area: (T,) contact areas.
        sensor: of the twin, whose threshold and window count.
    """
    untouched = np.flatnonzero(np.cumsum(area) == 0)[:CENTRE_REST_FRAMES]
    rest = images[untouched if len(untouched) else [0]].mean(0)
    centres, limit = np.full((len(images), 2), np.nan), 3 * sensor.model.threshold_levels
    for t in np.flatnonzero(area > 0):
        pressed = np.abs(images[t] - rest).sum(2) > limit
        if pressed.sum() >= LEAST_PIXELS:
            centres[t] = centre_mm(pressed, sensor.model.window_mm)
    return centres


def strengths(images: np.ndarray, rest: np.ndarray, gain: np.ndarray | float = 1.0) -> np.ndarray:
    """How strong the imprints are (T,), levels: the mean change beyond `FAINT_LEVELS` over each image.

    Contact area counts pixels above a threshold; this weighs them by their change. The light drifts
    while a finger presses, by about as much as an imprint grows: each colour of a frame is first brought to
    the brightness of the rest image, by the median of their ratio, as most of the gel is not touched.

    Args:
        images: uint8 (T, H, W, 3).
        rest: uint8 (H, W, 3).
        gain: by which each colour (3,) is brighter than the light in which imprints are measured.
    """
    return np.array([change.mean() for change in _changes(images, rest, gain)])


def turns_deg(images: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """How imprints are turned in the image (T,), degrees: their long axis, by second moments; NaN where none.

    Args:
        images: uint8 (T, H, W, 3).
        rest: uint8 (H, W, 3).
    """
    out = np.full(len(images), np.nan)
    for t, change in enumerate(_changes(images, rest)):
        m = cv2.moments(change)
        if m["m00"] > LEAST_SHOWN * change.size:
            out[t] = np.degrees(0.5 * np.arctan2(2 * m["mu11"], m["mu20"] - m["mu02"]))
    return out


def brightness(rest: np.ndarray) -> np.ndarray:
    """Of each colour (3,) of a rest image uint8 (H, W, 3), levels."""
    return np.maximum(rest.mean((0, 1), dtype=float), 1.0)


def _changes(images: np.ndarray, rest: np.ndarray, gain: np.ndarray | float = 1.0) -> Iterator[np.ndarray]:
    """Change beyond `FAINT_LEVELS` of each image (H, W), levels; see `strengths`."""
    ground = np.maximum(rest, 1).astype(np.float32)
    few = (slice(None, None, APART),) * 2
    for image in images:
        shown = np.median(image[few] / ground[few], axis=(0, 1)).astype(np.float32)
        change = (gain * np.abs(cv2.blur(image / shown - ground, (3, 3)))).mean(2)
        yield np.maximum(change - FAINT_LEVELS, 0)


@dataclass(frozen=True)
class LightDrift:
    """How the light of a gel at rest differs from the twin's.

    Attributes:
        levels: (3,) mean difference of red, green and blue, 8-bit levels.
        shape_levels: root mean square of what a factor on each colour does not explain.
        gain: (3,) factor on each colour of the twin's rest image.
        spread_levels: standard deviation of `levels` from episode to episode.
    """

    levels: tuple[float, float, float]
    shape_levels: float
    gain: tuple[float, float, float]
    spread_levels: float

    @property
    def drifted(self) -> bool:
        """Whether it is more than episodes differ and than a camera's noise."""
        return max(map(abs, self.levels)) > max(DRIFT_LEVELS, 3 * self.spread_levels) or (
            self.shape_levels > SHAPE_LEVELS
        )

    @property
    def sentence(self) -> str:
        """Whether it has changed, and what to do."""
        r, g, b = (f"{100 * (x - 1):+.1f} %" for x in self.gain)
        if not self.drifted:
            return f"The gel's light is as when the twin was made (red {r}, green {g}, blue {b})."
        return (
            f"The gel's light has changed since the twin was made: red {r}, green {g}, blue {b}, and "
            f"{self.shape_levels:.2g} levels in its shape; `pneutac calibrate` with these demonstrations "
            "takes the new rest image."
        )

    def to_dict(self) -> dict:
        return {
            "levels": list(self.levels),
            "shape_levels": self.shape_levels,
            "gain": list(self.gain),
            "spread_levels": self.spread_levels,
            "drifted": self.drifted,
        }


def light_drift(episodes: list[Episode], rest: np.ndarray) -> LightDrift:
    """How the gel at rest in episodes differs from a twin's rest image, uint8 (H, W, 3)."""
    seen = np.stack([rest_image(e) for e in episodes]).astype(float)
    ground = rest.astype(float)
    each = (seen - ground).mean((1, 2))
    mean = seen.mean(0)
    gain = (mean * ground).sum((0, 1)) / np.maximum((ground**2).sum((0, 1)), 1e-9)
    apart = cv2.blur(mean - gain * ground, (9, 9))
    return LightDrift(
        tuple(each.mean(0).tolist()),
        float(np.sqrt((apart**2).mean())),
        tuple(gain.tolist()),
        float(each.std(0).max()) if len(each) > 1 else 0.0,
    )
