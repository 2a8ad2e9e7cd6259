"""Presses stated wrongly, held as stated or found in their images: `python benchmarks/tactile_misplaced.py`.

Every fourth photograph in turn is the one calibration press. Its place is moved at random by 0.3 mm along
each axis and its depth by 15 % (standard deviations), stated as uncertain by as much or as certain, and all
other photographs are predicted. Data: the folder `tactile` of $PNEUTAC_DATA, or `--data=DIR`.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.pair import score
from pneutac_sim.gel.photograph import Predictor

PLACE_MM, DEPTH = 0.3, 0.15
EVERY = 4


def tried(folder: Path, k: int) -> tuple[float, ...]:
    """Contact RMSE held and found, then what place [mm] and depth (share) are off by, before and after."""
    data = GelRecording.load(Recording.load(folder))
    true, by = (
        data.samples[k].press,
        np.random.default_rng(k).standard_normal(3) * (PLACE_MM, PLACE_MM, DEPTH),
    )
    depth = true.depth_mm * (1 + by[2])
    sd = {"x_mm": PLACE_MM, "y_mm": PLACE_MM, "depth_mm": DEPTH * depth}
    moved = replace(true, x_mm=true.x_mm + by[0], y_mm=true.y_mm + by[1], depth_mm=depth)
    others, errors, off = [s for i, s in enumerate(data.samples) if i != k], [], []
    for deviations in ({}, sd):
        pair = replace(data.samples[k], press=moved, sd=deviations)
        fit = fit_presses([pair], data.px_per_mm, None, data.thickness_mm)
        predictor, found = Predictor(fit.gel, [pair]), fit.presses[0]
        scores = [
            score(predictor.image(s.press, s.rest, s.clock), s.image, s.rest, s.x_px, s.y_px, s.radius_px)
            for s in others
        ]
        errors.append(np.mean([s.contact_rmse for s in scores]))
        off += [
            np.hypot(found.x_mm - true.x_mm, found.y_mm - true.y_mm),
            abs(found.depth_mm / true.depth_mm - 1),
        ]
    return (*errors, *off)


def main() -> None:
    """Prints a row a set: means."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("PNEUTAC_DATA", "data")) / "tactile")
    parser.add_argument("--jobs", type=int, default=None, help="processes; as many as cores by default")
    options = parser.parse_args()
    print("| set | held as stated | found | place off by, mm | depth off by |\n|---|---|---|---|---|")
    with ProcessPoolExecutor(options.jobs) as pool:
        for folder in sorted(p.parent for p in options.data.glob("*/recording.json")):
            presses = range(0, len(GelRecording.load(Recording.load(folder)).samples), EVERY)
            rows = np.array(list(pool.map(tried, [folder] * len(presses), presses)))
            held, found, place, depth, place_found, depth_found = rows.mean(0)
            print(
                f"| {folder.name} | {held:.1f} | {found:.1f} | {place:.2f} to {place_found:.2f} | "
                f"{100 * depth:.0f} to {100 * depth_found:.0f} % |",
                flush=True,
            )


if __name__ == "__main__":
    main()
