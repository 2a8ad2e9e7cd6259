"""Which press one calibrates with, and how many: `python benchmarks/tactile_presses.py --presses=1,3,5`.

Every photograph of a recorded gel is tried as the one calibration press, and random sets of several; each
time all others are predicted. Data: the folder `tactile` of $PNEUTAC_DATA, or `--data=DIR`.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.metrics import ImageScores, score
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.gel.told import open_levels


def predicted_by(folder: Path, presses: tuple[int, ...]) -> tuple[str, ImageScores]:
    """The make that was recognised, and mean scores over all photographs but these presses."""
    data = GelRecording.load(Recording.load(folder))
    pairs = [data.samples[k].photograph for k in presses]
    fit = fit_presses(pairs, data.px_per_mm, None, data.thickness_mm)
    predictor = Predictor(fit.gel, pairs)
    others = [s for i, s in enumerate(data.samples) if i not in presses]
    return fit.make, ImageScores.mean(
        [
            score(predictor.image(s.press, s.rest, s.clock), s.image, s.rest, s.x_px, s.y_px, s.radius_px)
            for s in others
        ]
    )


def advised(folder: Path, first: int) -> tuple[int, int]:
    """A press and, of all other photographs' presses, the one that leaves least open beside it."""
    data = GelRecording.load(Recording.load(folder))
    fit = fit_presses([data.samples[first].photograph], data.px_per_mm, None, data.thickness_mm)
    left = open_levels(fit.gel, fit.channels, [s.press for s in data.samples])[1]
    left[first] = np.inf
    return first, int(np.argmin(left))


def choices(n: int, samples: int, sets: int) -> list[tuple[int, ...]]:
    """Every one press, or some sets of n."""
    if n == 1:
        return [(k,) for k in range(samples)]
    rng = np.random.default_rng(0)
    return [tuple(rng.choice(samples, n, replace=False).tolist()) for _ in range(sets)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--presses", default="1,3,5", help="numbers of presses, joined by commas")
    parser.add_argument("--sets", type=int, default=8, help="random sets of several presses")
    parser.add_argument("--data", type=Path, default=None, help="folder of recorded gels")
    parser.add_argument("--advised", action="store_true", help="every press, with the one that it asks for")
    options = parser.parse_args()
    root = options.data or Path(os.environ.get("PNEUTAC_DATA", "")) / "tactile"
    folders = sorted(f.parent for f in root.glob("*/recording.json"))
    if not folders:
        parser.error(f"{root} holds no recorded gel; give --data=DIR or set PNEUTAC_DATA.")
    table = Table("set", "presses", "tried", "make told", "RMSE", "in contact", "worst", "NCC in contact")
    with ProcessPoolExecutor() as pool:
        for folder in folders:
            count = len(GelRecording.load(Recording.load(folder)).samples)
            tries = [(n, choices(int(n), count, options.sets)) for n in options.presses.split(",")]
            if options.advised:
                pairs = list(pool.map(advised, [folder] * count, range(count)))
                tries.append(("2, advised", pairs))
            for n, sets in tries:
                found = list(pool.map(predicted_by, [folder] * len(sets), sets))
                contact = np.array([s.contact_rmse for _, s in found])
                ncc = np.median([s.contact_dncc for _, s in found])
                makes = sum(bool(make) for make, _ in found)
                rmse = np.median([s.rmse for _, s in found])
                row = folder.name, n, len(sets), makes, f"{rmse:.2f}", f"{np.median(contact):.1f}"
                table.add_row(*map(str, row), f"{contact.max():.1f}", f"{ncc:.3f}")
    Console().print(table)


if __name__ == "__main__":
    main()
