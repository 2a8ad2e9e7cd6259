"""How many grey levels a dragged contact changes, without markers, by finite elements and ray tracing.

Run: .venv/bin/python benchmarks/tactile_shear.py [--seeds="[1]"] [--out=outputs/tactile_shear.json]
"""

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from pneutac_benchmarks.tactile.drag import drag
from pneutac_truths.gel.scene import Look, Sensor, grid, shine
from pneutac_truths.gel.session import device
from pneutac_truths.gel.solid import Face, Punch

PRESSES = ((Punch("sphere", 3.0), 0.9),)
DRAGS_MM = [0.0, 0.2, 0.5, 1.0]
FRICTION = 1.0  # of tacky silicone; it slides at about 0.5 mm
AT_MM = (0.5, -0.4)  # of the punch in the photograph
MOVED_MM, DEEPER_MM = 0.1, 0.05
SMOOTH_MM = 0.2
FINE_MM = 0.35  # of the elements: a tenth of the time that 0.25 takes


def image(sensor: Sensor, face: Face | None, x_mm: float, seed: int, scale: float) -> np.ndarray:
    """Levels (H, W, 3) without the chip's noise; smoothed, since rays are noisier than any chip."""
    x, y = grid(sensor)
    u = np.zeros((*x.shape, 3)) if face is None else face.at(x - x_mm, y - AT_MM[1])
    light = np.einsum("lhw,lc->hwc", shine(sensor, u, Look(), seed), np.array(sensor.colours))
    return 255 * 0.62 * cv2.GaussianBlur(light, (0, 0), SMOOTH_MM * sensor.px_per_mm) / scale


def measured(seed: int, punch: Punch, depth_mm: float) -> list[dict]:
    """A row for each drag."""
    sensor, rubber = device(seed)
    faces = drag(punch, depth_mm, DRAGS_MM, rubber, FRICTION, FINE_MM)
    deeper = drag(punch, depth_mm + DEEPER_MM, [0.0], rubber, FRICTION, FINE_MM)[0]
    x, y = grid(sensor)
    light = np.einsum(
        "lhw,lc->hwc", shine(sensor, np.zeros((*x.shape, 3)), Look(), seed), np.array(sensor.colours)
    )
    scale = float(np.quantile(light, 0.9))
    rest = image(sensor, None, 0.0, seed, scale)
    base = image(sensor, faces[0], AT_MM[0], seed, scale)
    again = image(sensor, faces[0], AT_MM[0], seed + 100, scale)
    other = [
        image(sensor, faces[0], AT_MM[0] + MOVED_MM, seed, scale),
        image(sensor, deeper, AT_MM[0], seed, scale),
    ]
    radius = 2 * max(punch.reach_mm(depth_mm))
    px, py = sensor.pixel(*AT_MM)
    v, w = np.indices(rest.shape[:2])
    near = np.hypot(w - px, v - py) < radius * sensor.px_per_mm
    ways = np.stack([(o - base)[near].ravel() for o in other], -1)

    def rms(d):
        return round(float(np.sqrt(np.mean(np.square(d)))), 2)

    out = []
    for by, face in zip(DRAGS_MM[1:], faces[1:], strict=True):
        off = (image(sensor, face, AT_MM[0] - by, seed, scale) - base)[near]
        share = np.linalg.lstsq(ways, off.ravel(), rcond=None)[0]
        out.append(
            {
                "seed": seed, "punch": punch.kind, "drag_mm": by,
                "contact_changes": rms((base - rest)[near]),
                "ray_noise": rms((again - base)[near]),
                "shear_changes": rms(off),
                "left_by_place_and_depth": rms(off.ravel() - ways @ share),
                "as_moved_mm": round(float(share[0] * MOVED_MM), 3),
                "as_deeper_mm": round(float(share[1] * DEEPER_MM), 3),
            }
        )  # fmt: skip
        print(out[-1], flush=True)
    return out


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="[1]")
    parser.add_argument("--out", type=Path, default=Path("outputs/tactile_shear.json"))
    args = parser.parse_args()
    rows = [row for seed in json.loads(args.seeds) for press_ in PRESSES for row in measured(seed, *press_)]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
