"""Effects of a gel's optics: what each changes over a session, by name.

Every one is a function of a `Session`; its parameters are drawn from the seed within `ranges`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from pneutac_truths.effects.table import Effect, described
from pneutac_truths.gel.scene import Look, Sensor, grid


@dataclass
class Session:
    """A recording of n photographs in the making; the first is the rest image."""

    sensor: Sensor  # what photographs
    time_s: np.ndarray  # (n,) when each was taken
    rng: np.random.Generator  # of the session
    power: np.ndarray  # (n, LEDs) of each LED, 1 as designed
    exposure: float = 0.62  # share of full scale that the brightest tenth of the rest image reaches
    looks: list[Look] = field(default_factory=list)  # n states of coat, dust and camera
    # (n, H) what each row of the chip collects, 1 as designed
    rows: np.ndarray = field(default_factory=lambda: np.ones((0, 0)))


class Fault(Effect):
    """One departure from the plain sensor."""

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Parameters, uniform within their ranges."""
        return {k: float(rng.uniform(*r)) for k, r in self.ranges.items()}


GEL_EFFECTS: dict[str, Fault] = {}


def _fault(**ranges):
    def enter(act: Callable) -> Callable:
        name, (summary, source) = act.__name__, described(act)
        GEL_EFFECTS[name] = Fault(name, summary, True, ("gel",), source, "light", ranges, act)
        return act

    return enter


def _looks(s: Session, **each) -> None:
    """Sets fields of every look from arrays or lists of n."""
    s.looks = [replace(look, **{k: v[i] for k, v in each.items()}) for i, look in enumerate(s.looks)]


@_fault(lost=(0.25, 0.5), radius_mm=(1.2, 2.2))
def worn_membrane(s: Session, lost: float, radius_mm: float) -> None:
    """Presses rub the coat off in a patch and in scratches; it reflects less from press to press.

    Wears a patch and five scratches. Source: Archard, J. Appl. Phys. 24 (1953) 981 (wear grows with the
    number of contacts).
    """
    x, y = grid(s.sensor)
    cx, cy = s.rng.uniform(-0.25, 0.25, 2) * s.sensor.window_mm
    worn = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / radius_mm**2)
    scratches = np.zeros(x.shape, np.float32)
    h, w = x.shape
    for _ in range(5):
        a, b = s.rng.uniform(0, [w, h], (2, 2)).astype(int)
        cv2.line(scratches, a.tolist(), b.tolist(), 1.0, 1, cv2.LINE_AA)
    worn = np.maximum(worn, cv2.GaussianBlur(scratches, (0, 0), 0.8))
    share = np.linspace(0, 1, len(s.looks))
    _looks(s, coat=[1 - lost * k * worn for k in share])


@_fault(specks=(15, 40), largest_mm=(0.15, 0.3))
def dust(s: Session, specks: float, largest_mm: float) -> None:
    """Dust falls on the plate between camera and gel during the session.

    Adds dust particles, each from a random time on. Source: Willson et al., Proc. SPIE 5613 (2005) (dust on a
    lens).
    """
    n = int(specks)
    place = s.rng.uniform(-0.4, 0.4, (n, 2)) * s.sensor.window_mm
    all_ = np.column_stack([place, s.rng.uniform(0.3, 1.0, n) * largest_mm])
    falls = s.rng.uniform(0, 0.6, n) * s.time_s[-1]
    _looks(s, specks_mm=[all_[falls < t] for t in s.time_s])


@_fault(share=(0.55, 0.75), which=(0, 2.999), when=(0.2, 0.5))
def dim_led(s: Session, share: float, which: float, when: float) -> None:
    """One LED is dimmer from some press on: a bad contact.

    Dims an LED after the share `when` of the session. Source: Narendran and Gu, J. Display Technol. 1 (2005)
    167 (LEDs fail by dimming).
    """
    s.power[s.time_s > when * s.time_s[-1], int(which)] *= share


@_fault(about_x_deg=(-1.5, 1.5), about_y_deg=(1.0, 2.0))
def tilted_camera(s: Session, about_x_deg: float, about_y_deg: float) -> None:
    """The camera sits tilted in its holder, in the rest image too.

    Turns the camera about its pinhole. Source: Hartley and Zisserman, Multiple View Geometry (2004) ch. 8.
    """
    tilt = (np.radians(about_x_deg), np.radians(about_y_deg))
    _looks(s, tilt_rad=[tilt] * len(s.looks))


@_fault(warmer_k=(15, 30), settles_s=(120, 300), red_per_k=(0.006, 0.01), blue_per_k=(0.001, 0.003))
def heating_drift(s: Session, warmer_k: float, settles_s: float, red_per_k: float, blue_per_k: float) -> None:
    """The LEDs warm up and dim, the red one most.

    Output exp(-b dT), dT approaching its end exponentially. Source: Schubert, Light-Emitting Diodes (2006)
    ch. 6 (red AlGaInP falls fastest with temperature).
    """
    dT = warmer_k * (1 - np.exp(-s.time_s / settles_s))
    s.power *= np.exp(-dT[:, None] * np.array([red_per_k, blue_per_k, blue_per_k]))


@_fault(times=(1.7, 2.3))
def saturation(s: Session, times: float) -> None:
    """The exposure is too long: bright parts clip.

    Multiplies the exposure, in the rest image too. Source: EMVA Standard 1288 (2021) (saturation of the
    pixel).
    """
    s.exposure *= times


@_fault(depth=(0.05, 0.12), bands=(1.5, 4.0))
def rolling_exposure(s: Session, depth: float, bands: float) -> None:
    """LEDs dimmed by pulses beat with the rolling shutter: bands that wander from image to image.

    A sine along the rows with another phase in each image. Source: Liang, Chang and Chen, IEEE T. Image
    Process. 17 (2008) 1323 (rolling shutter).
    """
    h = s.sensor.image_px[1]
    phase = s.rng.uniform(0, 2 * np.pi, (len(s.looks), 1))
    s.rows *= 1 + depth * np.sin(2 * np.pi * bands * np.arange(h) / h + phase)
