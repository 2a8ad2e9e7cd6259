"""What generated gel recordings share: where balls are pressed in, and the table of what was done."""

from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.indenter import Press

BALLS_MM = (3.0, 2.0, 4.0)


def ball_press(i: int, rng: np.random.Generator) -> Press:
    """The press number `i` of a session; the first, to calibrate by, is always the same."""
    x, y = (0.4, 0.3) if i == 0 else rng.uniform((-4.0, -5.5), (4.0, 5.5))
    depth = 0.9 if i == 0 else rng.uniform(0.5, 1.2)
    return Press("sphere", BALLS_MM[i % len(BALLS_MM)], x, y, depth)


def press_row(i: int, image: str, press: Press) -> dict:
    """The row of `samples.csv` of the press number `i`, photographed in the file `image`."""
    return {
        "role": "heldout" if i else "calibration",
        "trial": i,
        "time_s": 0.0,
        "image": image,
        "indenter": press.indenter,
        "indenter_radius_mm": press.size_mm,
        "x_mm": press.x_mm,
        "y_mm": press.y_mm,
        "depth_mm": press.depth_mm,
    }


def write_session(folder: Path, rows: list[dict], px_per_mm: float, notes: str) -> Recording:
    """Writes what is known of the images that `folder` holds already; returns the recording as loaded."""
    meta = {
        "rest_image": "rest.png",
        "samples": "samples.csv",
        "px_per_mm": px_per_mm,
        "generated": True,
        "notes": notes,
    }
    Recording(folder, meta, pd.DataFrame(rows), "gel").write(folder)
    return Recording.load(folder)
