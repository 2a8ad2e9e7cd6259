"""A generated gel recording, for use where no photographs are at hand.

Its light is deliberately not the model's: three point LEDs with inverse-square fall-off and Lambert's cosine
on a Hertz half-space, with attached shadows, sensor noise and a drift of brightness between images.

What generated gel recordings share: where balls are pressed in, and the table of what was done.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.indenter import Press

BALLS_MM = (3.0, 2.0, 4.0)


def ball_press(i: int, rng: np.random.Generator) -> Press:
    """The press number `i` of a session; the first, to calibrate by, is always the same."""
    x, y = (0.4, 0.3) if i == 0 else rng.uniform((-4.0, -5.5), (4.0, 5.5))
    depth = 0.9 if i == 0 else rng.uniform(0.5, 1.2)
    return Press("sphere", BALLS_MM[i % len(BALLS_MM)], x, y, depth)


def write_presses(
    folder: str | Path,
    rest: np.ndarray,
    photographs: Iterable[tuple[Press, np.ndarray, dict]],
    px_per_mm: float,
    notes: str,
) -> Recording:
    """Writes a gel's recording; returns it as loaded.

    Args:
        folder: where it goes.
        rest: image without contact, (H, W, 3) levels.
        photographs: of each press, the first of which is to calibrate by: the press, its image and what else
            is known of it, by column.
        px_per_mm: scale of the images.
        notes: on their origin.
    """
    folder, rows = Path(folder), []
    (folder / "images").mkdir(parents=True, exist_ok=True)

    def save(image: np.ndarray, name: str) -> None:
        Image.fromarray(np.clip(image, 0, 255).round().astype(np.uint8)).save(folder / name)

    save(rest, "rest.png")
    for i, (press, image, more) in enumerate(photographs):
        row = {"role": "heldout" if i else "calibration", "trial": i, "time_s": 0.0}
        row |= {"image": f"images/ball_{i}.png", "indenter": press.indenter}
        row |= {"indenter_radius_mm": press.size_mm, "x_mm": press.x_mm, "y_mm": press.y_mm}
        save(image, row["image"])
        rows.append(row | {"depth_mm": press.depth_mm} | more)
    meta = {"rest_image": "rest.png", "samples": "samples.csv", "px_per_mm": px_per_mm}
    meta |= {"generated": True, "notes": notes}
    Recording(folder, meta, pd.DataFrame(rows), "gel").write(folder)
    return Recording.load(folder)


WIDTH, HEIGHT, PX_PER_MM = 240, 320, 20.0
BALL_RADIUS_MM = 3.0
NOISE_LEVELS, DRIFT_SHARE = 2.0, 0.01

# LEDs: place (x, y, height above the gel) in mm, colour, strength
_LEDS = (
    ((-15.0, -5.0, 9.0), (1.0, 0.12, 0.20), 1.0),
    ((15.0, -4.0, 9.0), (0.15, 1.0, 0.25), 1.0),
    ((0.0, 18.0, 9.0), (0.12, 0.20, 1.0), 1.3),
)
_AMBIENT, _EXPOSURE = 0.2, 100.0


def write_gel_recording(folder: str | Path, seed: int = 0, heldout: int = 6) -> Recording:
    """Writes a rest image, one calibration and several held-out indentations by a ball of 3 mm radius.

    The seed decides places, depths and noise; the recording is returned as loaded from the folder.
    """
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(
        (np.arange(WIDTH) + 0.5 - WIDTH / 2) / PX_PER_MM, (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / PX_PER_MM
    )

    def photograph(u: np.ndarray) -> np.ndarray:
        exposure = _EXPOSURE * (1 + DRIFT_SHARE * rng.standard_normal())
        return exposure * _radiance(u, x, y) + NOISE_LEVELS * rng.standard_normal((*u.shape, 3))

    def presses() -> Iterator[tuple[Press, np.ndarray, dict]]:
        for i in range(heldout + 1):
            cx, cy = (0.6, 0.5) if i == 0 else rng.uniform((-3.5, -5.0), (3.5, 5.0))
            depth = 0.9 if i == 0 else rng.uniform(0.5, 1.1)
            image = photograph(hertz(np.hypot(x - cx, y - cy), depth, BALL_RADIUS_MM))
            radius_px = np.sqrt(BALL_RADIUS_MM * depth) * PX_PER_MM
            yield Press("sphere", BALL_RADIUS_MM, cx, cy, depth), image, {"contact_radius_px": radius_px}

    notes = "Generated: point LEDs on a Hertz half-space, with noise and drift; not photographs."
    return write_presses(folder, photograph(np.zeros_like(x)), presses(), PX_PER_MM, notes)


def hertz(r_mm: np.ndarray, depth_mm: float, radius_mm: float) -> np.ndarray:
    """Surface displacement of an elastic half-space under a ball, mm (Johnson, Contact Mechanics).

    u = d - r^2 / 2R inside a = sqrt(R d), outside (a sqrt(r^2 - a^2) + (2 a^2 - r^2) asin(a / r)) / (pi R).
    """
    a2 = radius_mm * depth_mm
    r2 = np.square(r_mm)
    out = np.maximum(r2, a2)
    far = np.sqrt(a2 * (out - a2)) + (2 * a2 - out) * np.arcsin(np.sqrt(a2 / out))
    return np.where(r2 < a2, depth_mm - r2 / (2 * radius_mm), far / (np.pi * radius_mm))


def _radiance(u: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Light that the gel surface, pushed by u towards the LEDs, sends to the camera, (H, W, 3)."""
    uy, ux = np.gradient(u, 1 / PX_PER_MM)
    cosine_scale = 1 / np.sqrt(1 + ux**2 + uy**2)
    image = np.full((*u.shape, 3), _AMBIENT)
    for (px, py, height), colour, strength in _LEDS:
        lx, ly, lz = px - x, py - y, height - u
        distance = np.sqrt(lx**2 + ly**2 + lz**2)
        # the normal towards the LEDs is (-du/dx, -du/dy, 1), heights counted from the gel to the LEDs
        lambert = np.maximum(lz - lx * ux - ly * uy, 0.0) * cosine_scale / distance
        image += (strength * lambert * 400.0 / distance**2)[..., None] * np.array(colour)
    return image
