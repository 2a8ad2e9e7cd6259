"""From a seed to the bench recording of a gel: presses, photographs and what is known of them."""

import json
from functools import lru_cache
from pathlib import Path
from zlib import crc32

import cv2
import numpy as np
import pandas as pd

from pneutac_truths.gel.faults import GEL_EFFECTS, Session
from pneutac_truths.gel.scene import Look, Sensor, grid, shine
from pneutac_truths.gel.solid import Face, Punch, Rubber, press

PRESSES = 13
EVERY_S = 30.0
NOISE_LEVELS = 1.0  # of the chip, besides the noise of the rays
BLUR_PX = 0.7  # the lens is not sharper
KINDS = ("sphere", "sphere", "cylinder", "sphere", "cube", "edge", "sphere", "cone")  # in turn


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
