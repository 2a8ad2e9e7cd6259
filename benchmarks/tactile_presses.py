"""Which press one calibrates with, and how many: `python benchmarks/tactile_presses.py --presses=1,3,5`.

Every photograph of a recorded gel is tried as the one calibration press, and random sets of several; each
time all others are predicted. Data: the folder `tactile` of $PNEUTAC_DATA, or `--data=DIR`.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.fit import GelFit, fit_presses
from pneutac_sim.gel.identifiability import open_levels
from pneutac_sim.gel.layout import DIGIT
from pneutac_sim.gel.pair import ImageScores, PressPhotograph, score
from pneutac_sim.gel.photograph import Predictor


def fitted(pairs: list[PressPhotograph], data: GelRecording, fields: str) -> GelFit:
    """The fit to some presses: with all residual fields, that which the make lends alone, or none."""
    makes = (DIGIT if fields != "none" else replace(DIGIT, units=()),)
    fit = fit_presses(pairs, data.px_per_mm, None, data.thickness_mm, makes)
    if fields != "all":
        fit.gel.residual = None
    return fit


def predicted_by(folder: Path, fields: str, presses: tuple[int, ...]) -> tuple[str, ImageScores]:
    """The make that was recognised, and mean scores over all photographs but these presses."""
    data = GelRecording.load(Recording.load(folder))
    pairs = [data.samples[k] for k in presses]
    fit = fitted(pairs, data, fields)
    predictor = Predictor(fit.gel, pairs)
    others = [s for i, s in enumerate(data.samples) if i not in presses]
    return fit.make, ImageScores.mean(
        [
            score(predictor.image(s.press, s.rest, s.clock), s.image, s.rest, s.x_px, s.y_px, s.radius_px)
            for s in others
        ]
    )


def advised(folder: Path, fields: str, first: int) -> int:
    """Of all other photographs' presses, the one that leaves least open beside the first."""
    data = GelRecording.load(Recording.load(folder))
    fit = fitted([data.samples[first]], data, fields)
    left = open_levels(fit.gel, fit.channels, [s.press for s in data.samples])[1]
    left[first] = np.inf
    return int(np.argmin(left))


def choices(n: int, samples: int, sets: int) -> list[tuple[int, ...]]:
    """Every one press, or some sets of n."""
    if n == 1:
        return [(k,) for k in range(samples)]
    rng = np.random.default_rng(0)
    return [tuple(rng.choice(samples, n, replace=False).tolist()) for _ in range(sets)]


def by_number(folder: Path, numbers: list[int], options, pool) -> list[tuple]:
    """Rows of the table."""
    count, rows = len(GelRecording.load(Recording.load(folder)).samples), []
    for n in numbers:
        sets = choices(n, count, options.sets)
        found = list(pool.map(partial(predicted_by, folder, options.fields), sets))
        contact = np.array([s.contact_rmse for _, s in found])
        makes = sum(bool(make) for make, _ in found)
        rmse, ncc = (np.median([getattr(s, name) for _, s in found]) for name in ("rmse", "contact_dncc"))
        row = folder.name, n, len(sets), makes, f"{rmse:.2f}", f"{np.median(contact):.1f}"
        rows.append((*map(str, row), f"{contact.max():.1f}", f"{ncc:.3f}"))
    return rows


def by_second(folder: Path, options, pool) -> tuple:
    """Contact RMSE, median and worst: one press, all pairs, with the second as asked for, with the best."""
    count = len(GelRecording.load(Recording.load(folder)).samples)
    pairs = list(combinations(range(count), 2))
    by = partial(predicted_by, folder, options.fields)
    one = [s.contact_rmse for _, s in pool.map(by, choices(1, count, 0))]
    two = np.full((count, count), np.inf)
    for (a, b), (_, s) in zip(pairs, pool.map(by, pairs, chunksize=4), strict=True):
        two[a, b] = two[b, a] = s.contact_rmse
    seconds = list(pool.map(partial(advised, folder, options.fields), range(count)))
    every = two[np.triu_indices(count, 1)]
    each = one, every, two[np.arange(count), seconds], two.min(1)
    return folder.name, *(f"{np.median(v):.1f} / {np.max(v):.1f}" for v in each)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--presses", default="1,3,5", help="numbers of presses, joined by commas")
    parser.add_argument("--sets", type=int, default=8, help="random sets of several presses")
    parser.add_argument("--data", type=Path, default=None, help="folder of recorded gels")
    parser.add_argument("--fields", choices=("all", "lent", "none"), default="all", help="residual fields")
    parser.add_argument("--advised", action="store_true", help="every pair, and that which is asked for")
    parser.add_argument("--jobs", type=int, default=None, help="processes; as many as cores by default")
    options = parser.parse_args()
    root = options.data or Path(os.environ.get("PNEUTAC_DATA", "")) / "tactile"
    folders = sorted(f.parent for f in root.glob("*/recording.json"))
    if not folders:
        parser.error(f"{root} holds no recorded gel; give --data=DIR or set PNEUTAC_DATA.")
    table = Table("set", "presses", "tried", "make told", "RMSE", "in contact", "worst", "NCC in contact")
    pairs = Table("set", "one press", "any pair", "the second as asked for", "the best second")
    numbers = [int(n) for n in options.presses.split(",") if n]
    with ProcessPoolExecutor(options.jobs) as pool:
        for folder in folders:
            for row in by_number(folder, numbers, options, pool):
                table.add_row(*row)
            if options.advised:
                pairs.add_row(*by_second(folder, options, pool))
    for each in (table, pairs):
        if each.rows:
            Console(width=110).print(each)


if __name__ == "__main__":
    main()
