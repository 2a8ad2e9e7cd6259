"""Generated gel recordings, for use where no photographs are at hand.

The light of `write_gel_recording` is deliberately not the model's: three point LEDs with inverse-square
fall-off and Lambert's cosine on a Hertz half-space, with attached shadows, sensor noise and a drift of
brightness between images. `write_hidden_gel` hides effects of the light in the built-in gel.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from pneutac_datasets.generate.finger import write_truth
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import sensor_effects
from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import Earlier
from pneutac_sim.gel.photograph import Predictor

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
    """Writes a gel's recording into a folder; returns it as loaded.

    `rest` (H, W, 3) levels is the image without contact; of each press, the first of which is to calibrate
    by, come the press, its image and what else is known of it, by column.
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
    x, y = np.meshgrid(*((np.arange(n) + 0.5 - n / 2) / PX_PER_MM for n in (WIDTH, HEIGHT)))

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


# Effects of a size that real sensors show, others at their defaults; a seed varies them by a fifth.
SIZES = {
    "rest_colour": {"exponent_red": 1.2, "exponent_green": 1.2, "exponent_blue": 1.2},
    "near_light": {"distance_red_mm": 12.0, "distance_green_mm": 14.0, "distance_blue_mm": 16.0},
    "photometric_nonlinearity": {f"direct_{c}_levels": 25.0 for c in CHANNELS},
    "shadow": {f"shadow_{c}_levels": 50.0 for c in CHANNELS}
    | {f"elevation_{c}": 0.22 for c in CHANNELS}
    | {"edge_mm": 0.15},
    "illumination_drift": {"gain_red": 1.06, "gain_green": 0.96, "gain_blue": 1.02}
    | {"drift_red": -0.08, "drift_green": 0.1, "drift_blue": 0.06},
    "gel_creep": {"late_4s": 0.05, "late_20s": 0.1, "late_100s": 0.05},
    "registration_shift": {"shift_x_mm": 0.5, "shift_y_mm": -0.4, "turn_rad": 0.06, "scale": 1.08},
}
HOLDS_S, GAP_S = (60.0, 2.0), 3.0  # in turn, where what earlier presses leave is hidden


def write_hidden_gel(folder: str | Path, hidden: list[str], seed: int = 0, images: int = 16) -> Recording:
    """Writes a rest image and indentations by three balls, made by the built-in gel with hidden effects.

    What is hidden goes to `truth/<name>.json` next to the folder; the seed decides places, depths, sizes of
    the effects and noise. Raises InputError where an effect is no optics effect, or images are fewer than
    two.
    """
    rng, known = np.random.default_rng(seed), sensor_effects()
    for name in hidden:
        if name not in known:
            raise InputError(f"'{name}' is no optics effect; give one of {', '.join(known)}.")
    if images < 2:
        raise InputError(f"images is {images}; at least 2 are needed, one of them to calibrate by.")
    truth = {}
    for name in hidden:
        sizes = SIZES.get(name) or {p.name: p.default for p in known[name].parameters}
        truth[name] = {
            p.name: p.neutral + (sizes.get(p.name, p.neutral) - p.neutral) * rng.uniform(0.8, 1.2)
            for p in known[name].parameters
        }
    gel = GelModel.builtin()
    gel.effects = truth
    predictor = Predictor(gel)
    holds = np.resize(HOLDS_S, images)
    times = np.cumsum(holds + GAP_S)
    held = any(known[name].late for name in hidden)

    def presses() -> Iterator[tuple[Press, np.ndarray, dict]]:
        before: list[tuple] = []
        for i in range(images):
            press = ball_press(i, rng)
            clock = (times[i] - times[0]) / np.ptp(times) if held else i / (images - 1)
            earlier = [Earlier(p, h, times[i] - t) for p, h, t in before] if held else []
            image = predictor.image(press, gel.rest_image, clock, earlier).astype(np.float64)
            image += NOISE_LEVELS * rng.standard_normal(image.shape)
            yield press, image, {"time_s": times[i], "hold_s": holds[i]} if held else {}
            before.append((press, float(holds[i]), float(times[i])))

    # the rest image is taken once, without noise to speak of: cameras average it
    recording = write_presses(folder, gel.rest_image, presses(), PX_PER_MM, "Generated by the built-in gel.")
    write_truth(folder, truth)
    return recording
