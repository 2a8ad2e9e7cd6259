"""How well depth, place and contact come back from photographs of presses that are known.

    python benchmarks/tactile_inverse.py --presses=1

Each set's gel is calibrated by its presses of role `calibration` (or so many photographs, evenly spread) and
reads all others: the depth against the stated one, the contact against a disc of its stated radius, and time.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.inverse import Touch, TouchReader
from pneutac_sim.gel.layout import DIGIT

HEAD = (
    "| set | images | depth, mm | error | mean error | centre, mm | overlap | ms |\n"
    "|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    """Prints a row a set and role."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("PNEUTAC_DATA", "data")) / "tactile")
    parser.add_argument("--presses", type=int, default=0)
    options = parser.parse_args()
    print(HEAD)
    for folder in sorted(p for p in options.data.iterdir() if (p / "recording.json").is_file()):
        data = GelRecording.load(Recording.load(folder))
        n = len(data.samples)
        known = data.presses
        if options.presses:
            known = [data.samples[i] for i in np.linspace(0, n - 1, options.presses).round().astype(int)]
        fit = fit_presses(known, data.px_per_mm, None, data.thickness_mm, (DIGIT,))
        reader = TouchReader(fit.gel)
        others = [s for s in data.samples if s not in known]
        reader.read(others[0].image, others[0].rest)  # compiles
        for role in sorted({s.role for s in others}):
            samples = [s for s in others if s.role == role]
            began = time.process_time()
            read = [reader.read(s.image, s.rest) for s in samples]
            ms = 1e3 * (time.process_time() - began) / len(samples)
            print(row(f"{folder.name}, {role}", samples, read, data.px_per_mm, ms), flush=True)


def row(name: str, samples: list[GelSample], read: list[Touch], px_per_mm: float, ms: float) -> str:
    """Of the table: root mean square and mean errors of depth, median of the centre's, mean overlap."""
    pairs = list(zip(samples, read, strict=True))
    depth = np.array([s.press.depth_mm for s in samples])
    error = np.array([t.depth_mm for t in read]) - depth
    centre = np.nanmedian([np.hypot(*(t.centre_mm - (s.press.x_mm, s.press.y_mm))) for s, t in pairs])
    overlap = np.mean([_overlap(s, t, px_per_mm) for s, t in pairs])
    rms, of = np.sqrt(np.mean(error**2)), f"{depth.min():.2f} to {depth.max():.2f}"
    values = f"{rms:.3f} | {error.mean():+.3f} | {centre:.2f} | {overlap:.2f} | {ms:.1f}"
    return f"| {name} | {len(samples)} | {of} | {values} |"


def _overlap(s: GelSample, t: Touch, px_per_mm: float) -> float:
    """Intersection over union of the contact and the disc of the contact's stated radius."""
    rows, cols = t.contact.shape
    y = (np.arange(rows) + 0.5 - rows / 2)[:, None] * t.cell_mm[1] - s.press.y_mm
    x = (np.arange(cols) + 0.5 - cols / 2) * t.cell_mm[0] - s.press.x_mm
    disc = np.hypot(x, y) < s.radius_px / px_per_mm
    return float((t.contact & disc).sum() / (t.contact | disc).sum())


if __name__ == "__main__":
    main()
