"""A gel that creeps: a bench recording of presses that are held long and short.

The gel's memory is a stretched exponential (Kohlrausch 1854; Phillips, Rep. Prog. Phys. 59 (1996) 1133): of a
surface that was held for T, share (phi(s) - phi(s + T)) is left s after its release, phi(t) = exp(-(t /
tau)^beta), by Boltzmann's superposition. The next object meets what is left: contact on an elastic half-space
is solved on that face.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from pneutac_truths.light import SPHERE, Gel

HOLDS_S = (60.0, 2.0, 2.0)  # in turn
GAP_S = 3.0
WINDOW_MM, IMAGE = (12.0, 16.0), (160, 120, 3)
NOISE_LEVELS = 1.0
RADII_MM = (2.0, 3.0, 4.0)


@dataclass(frozen=True)
class Memory:
    """Of a gel.

    Attributes:
        share: of an endless hold that comes back late; 0 for a gel that does not creep.
        time_s: tau.
        stretch: beta.
    """

    share: float
    time_s: float
    stretch: float

    @classmethod
    def drawn(cls, share: float, rng: np.random.Generator) -> "Memory":
        """With a time of 10 to 60 s and a stretch of 0.4 to 0.7."""
        return cls(share, float(np.exp(rng.uniform(*np.log([10, 60])))), float(rng.uniform(0.4, 0.7)))

    def left(self, held_s: float, since_s: float) -> float:
        """Share of a surface that is left."""
        phi = [np.exp(-((t / self.time_s) ** self.stretch)) for t in (since_s, since_s + held_s)]
        return self.share * float(phi[0] - phi[1])


def write_creeping(
    folder: str | Path, share: float, seed: int = 0, presses: int = 16, held: bool = True
) -> Path:
    """Makes and writes one recording of balls.

    Args:
        folder: new; gets recording.json, samples.csv, images and truth.json.
        share: see `Memory`.
        seed: of places, depths, memory and noise.
        presses: how many; the first is to calibrate by.
        held: whether samples.csv states how long each press lasted.

    Raises:
        FileExistsError: the folder exists.
    """
    folder, rng = Path(folder), np.random.default_rng(seed)
    folder.mkdir(parents=True)
    gel, memory = Gel(IMAGE, WINDOW_MM), Memory.drawn(share, rng)
    _save(folder / "rest.png", gel.rest_image.astype(float), rng)
    rows, before, clock = [], [], 0.0
    for i in range(presses):
        hold = HOLDS_S[i % len(HOLDS_S)]
        clock += GAP_S + hold
        left = np.zeros(gel.shape)
        for moved, held_s, at in before:
            left += memory.left(held_s, clock - at) * moved
        deep = hold == max(HOLDS_S)
        depth = 0.8 if i == 0 else round(float(rng.uniform(*((0.7, 1.0) if deep else (0.3, 0.6)))), 2)
        x, y = (0.0, 0.0) if i == 0 else np.round(rng.uniform(-0.3, 0.3, 2) * WINDOW_MM, 2)
        radius = RADII_MM[i % len(RADII_MM)]
        up = radius - depth - (x * x + y * y) / (2 * gel.dome_mm)  # the face lies lower there, and leans:
        outward = 1 + radius / gel.dome_mm  # a ball touches it nearer to the middle than its own centre is
        place = [[x * outward, y * outward, up]]
        moved, _ = gel.press([SPHERE], [[radius, 0, 0]], place, [np.eye(3)], left)
        name = f"press_{i:02d}.png"
        _save(folder / name, gel.image(moved).astype(float), rng)
        before.append((moved, hold, clock))
        row = {"role": "heldout" if i else "calibration", "trial": i, "time_s": clock, "image": name}
        row |= {"indenter": "sphere", "indenter_radius_mm": radius, "x_mm": x, "y_mm": y, "depth_mm": depth}
        rows.append(row | ({"hold_s": hold} if held else {}))
    pd.DataFrame(rows).to_csv(folder / "samples.csv", index=False, lineterminator="\n")
    meta = {"device": "gel", "rest_image": "rest.png", "samples": "samples.csv", "generated": True}
    meta |= {
        "px_per_mm": IMAGE[1] / WINDOW_MM[0],
        "notes": "A truth: half-space, light by rays; not photographs.",
    }
    (folder / "recording.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
    (folder / "truth.json").write_text(
        json.dumps({"seed": seed} | vars(memory), indent=1) + "\n", encoding="utf-8"
    )
    return folder


def _save(file: Path, levels: np.ndarray, rng: np.random.Generator) -> None:
    noisy = levels + NOISE_LEVELS * rng.standard_normal(levels.shape)
    cv2.imwrite(str(file), np.clip(noisy, 0, 255).round().astype(np.uint8)[..., ::-1])
