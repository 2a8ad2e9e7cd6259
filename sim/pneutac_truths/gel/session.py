"""From a seed to the bench recording of a gel: presses, photographs and what is known of them.

An effect of the optics is a function of a `Session`; its parameters are drawn from the seed within `ranges`.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from zlib import crc32

import cv2
import numpy as np
import pandas as pd

from pneutac_truths.effects.table import Effect, described
from pneutac_truths.gel.scene import Look, Sensor, grid, shine
from pneutac_truths.gel.solid import Face, Punch, Rubber, press

PRESSES = 13
EVERY_S = 30.0
NOISE_LEVELS = 1.0  # of the chip, besides the noise of the rays
BLUR_PX = 0.7  # the lens is not sharper
KINDS = ("sphere", "sphere", "cylinder", "sphere", "cube", "edge", "sphere", "cone")  # in turn


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


def named(effects: list[str]) -> tuple[str, ...]:
    """Names of effects without `plain`; raises ValueError where a name is unknown."""
    names = [e for e in effects if e != "plain"]
    for name in names:
        if name not in GEL_EFFECTS:
            raise ValueError(f"There is no effect '{name}' of a gel; give one of {', '.join(GEL_EFFECTS)}.")
    return tuple(dict.fromkeys(names))


def write_gel(
    effects: list[str], folder: str | Path, seed: int = 0, day: int = 1, presses: int = PRESSES
) -> Path:
    """Makes and writes one recording into a new folder, by effects of `GEL_EFFECTS` or `plain`.

    It holds recording.json, samples.csv, images, truth.json and surfaces.npz. The seed decides the sensor,
    with the sizes of its effects, and the day the presses, of which the first is to calibrate by.

    Raises ValueError where an effect is unknown or presses are fewer than two, FileExistsError where the
    folder exists.
    """
    names, folder = named(effects), Path(folder)
    if presses < 2:
        raise ValueError(f"{presses} presses are too few; give two or more, one of them to calibrate by.")
    folder.mkdir(parents=True)
    sensor, rubber = device(seed)
    s = _session(sensor, presses + 1, _rng(seed, "day", day, *names))
    drawn = {n: GEL_EFFECTS[n].draw(_rng(seed, n)) for n in names}
    for name, parameters in drawn.items():
        GEL_EFFECTS[name].act(s, **parameters)
    x, y = grid(sensor)
    moved, rows, forces = [np.zeros((*x.shape, 3))], [], []
    for i in range(presses):
        row, face = _pressed(seed, day, i)
        moved.append(_turned(face, row, x, y))
        rows.append(_described(row, i, sensor, face, s.time_s[i + 1]))
        forces.append(face.force_n)
    scale = None
    for k, u in enumerate(moved):
        look, colour = s.looks[k], np.array(sensor.colours)
        light = _plain_light(seed, day, k) if look.plain else shine(sensor, u, look, seed)
        seen = np.einsum("lhw,lc->hwc", light * s.power[k][:, None, None], colour)
        scale = s.exposure / np.quantile(seen, 0.9) if scale is None else scale
        name = "rest.png" if k == 0 else rows[k - 1]["image"]
        level = 255 * scale * cv2.GaussianBlur(seen, (0, 0), BLUR_PX) * s.rows[k][:, None, None]
        level += NOISE_LEVELS * s.rng.standard_normal(level.shape)
        image = np.clip(level, 0, 255).round().astype(np.uint8)
        cv2.imwrite(str(folder / name), image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    _write(folder, sensor, rubber, rows)
    np.savez_compressed(
        folder / "surfaces.npz", into_gel_mm=-np.array(moved)[1:, ::2, ::2, 2].astype(np.float16)
    )
    known = {"device": "gel", "seed": seed, "day": day, "force_n": forces}
    known |= {"thickness_mm": rubber.thickness_mm, "mu_kpa": rubber.mu_kpa, "poisson": rubber.poisson}
    known["effects"] = [
        {"name": n, "summary": GEL_EFFECTS[n].summary, "parameters": p} for n, p in drawn.items()
    ]
    known["led_power"] = s.power.round(5).tolist()
    (folder / "truth.json").write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    return folder


def _write(folder: Path, sensor: Sensor, rubber: Rubber, rows: list[dict]) -> None:
    pd.DataFrame(rows).to_csv(folder / "samples.csv", index=False, float_format="%.6g", lineterminator="\n")
    meta = {"device": "gel", "rest_image": "rest.png", "samples": "samples.csv"}
    meta |= {"px_per_mm": sensor.px_per_mm}
    meta |= {"gel_size_mm": [*sensor.window_mm, round(rubber.thickness_mm, 3)], "generated": True}
    meta["notes"] = "A truth: rubber by finite elements, light by ray tracing; not photographs."
    (folder / "recording.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def device(seed: int) -> tuple[Sensor, Rubber]:
    """The sensor of a seed, and its gel."""
    rng = _rng(seed, "gel")
    z = -rng.uniform(6.0, 8.0, 3)
    sides = ("-x", "x", "y") if rng.random() < 0.5 else ("x", "-x", "-y")
    leds = tuple((side, float(h), float(rng.uniform(3.5, 5))) for side, h in zip(sides, z, strict=True))
    ranges = {"index": (1.40, 1.47), "reflectance": (0.45, 0.65), "gloss": (0.15, 0.35)}
    ranges |= {"roughness": (0.35, 0.5)}
    sensor = Sensor(leds=leds, **{name: float(rng.uniform(*range_)) for name, range_ in ranges.items()})
    return sensor, Rubber(float(rng.uniform(2.5, 3.5)), float(rng.uniform(25, 60)), 0.49)


def _session(sensor: Sensor, n: int, rng: np.random.Generator) -> Session:
    out = Session(sensor, EVERY_S * np.arange(n), rng, np.ones((n, len(sensor.leds))))
    out.looks, out.rows = [Look() for _ in range(n)], np.ones((n, sensor.image_px[1]))
    return out


def _plan(i: int, sensor: Sensor, rng: np.random.Generator) -> tuple[dict, Punch]:
    """What is pressed where; the first is a ball near the middle."""
    kind = KINDS[i % len(KINDS)]
    sizes = {"sphere": (2.0, 4.0), "cylinder": (1.0, 2.0), "cube": (2.5, 4.0), "edge": (3.0, 5.0)}
    low, high = sizes.get(kind, (3, 3))
    size = 3.0 if i == 0 else round(float(rng.uniform(low, high)), 1)
    x, y = (0.5, -0.4) if i == 0 else rng.uniform(-0.26, 0.26, 2) * sensor.window_mm
    deepest = 0.7 if kind in ("cylinder", "cube") else 1.0
    depth = 0.9 if i == 0 else round(float(rng.uniform(0.4, deepest)), 2)
    yaw = 0.0 if kind in ("sphere", "cylinder", "cone") else round(float(rng.uniform(-0.7, 0.7)), 2)
    row = {"indenter": kind, "size_mm": size, "x_mm": round(float(x), 3), "y_mm": round(float(y), 3)}
    return row | {"depth_mm": depth, "yaw_rad": yaw}, Punch(kind, size)


@lru_cache(maxsize=256)
def _pressed(seed: int, day: int, i: int) -> tuple[dict, Face]:
    """Press number i of a day: how it is made, and the face under it."""
    sensor, rubber = device(seed)
    row, punch = _plan(i, sensor, _rng(seed, "press", day, i))
    return row, press(punch, row["depth_mm"], rubber)


@lru_cache(maxsize=64)
def _plain_light(seed: int, day: int, k: int) -> np.ndarray:
    """Light of photograph k, 0 the rest image, in a sensor that is neither worn nor dusty nor tilted."""
    sensor, _ = device(seed)
    x, y = grid(sensor)
    u = _turned(*reversed(_pressed(seed, day, k - 1)), x, y) if k else np.zeros((*x.shape, 3))
    return shine(sensor, u, Look(), seed)


def _turned(face: Face, row: dict, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement (rows, columns, 3) of a grid under an indenter that was moved and turned."""
    c, s = np.cos(row["yaw_rad"]), np.sin(row["yaw_rad"])
    dx, dy = x - row["x_mm"], y - row["y_mm"]
    u = face.at(c * dx + s * dy, c * dy - s * dx)
    return np.stack([c * u[..., 0] - s * u[..., 1], s * u[..., 0] + c * u[..., 1], u[..., 2]], -1)


def _described(row: dict, i: int, sensor: Sensor, face: Face, time_s: float) -> dict:
    px, py = sensor.pixel(row["x_mm"], row["y_mm"])
    at = np.array(np.nonzero(face.touching))
    radius = np.hypot(face.x_mm[at[0]], face.y_mm[at[1]]).max()
    side = row["indenter"] in ("cube", "edge")
    out = {"role": "heldout" if i else "calibration", "trial": i, "time_s": time_s}
    out |= {"image": f"press_{i:02d}.png", "indenter": row["indenter"]}
    out |= {"indenter_radius_mm": None, "indenter_size_mm": None}
    out["indenter_size_mm" if side else "indenter_radius_mm"] = row["size_mm"]
    out |= {k: row[k] for k in ("x_mm", "y_mm", "depth_mm", "yaw_rad")}
    return out | {"contact_x_px": px, "contact_y_px": py, "contact_radius_px": radius * sensor.px_per_mm}


def _rng(*of) -> np.random.Generator:
    return np.random.default_rng([crc32(str(x).encode()) for x in of])
