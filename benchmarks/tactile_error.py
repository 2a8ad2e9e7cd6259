"""What the error in the contact is made of: `python benchmarks/tactile_error.py --presses=5`.

Sets of presses calibrate each gel and all other photographs are predicted. The mean squared error in their
contacts is told by place, colour and scale, and by what would be gone if something were known that no
prediction knows. Data: the folder `tactile` of $PNEUTAC_DATA, or recordings below `--data=DIR`.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import minimize

from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel import optics
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.pair import CONTACT_DISC, disc
from pneutac_sim.gel.photograph import Predictor, press_depth, session_light
from pneutac_sim.gel.sensor import TactileSensor
from tactile_presses import choices

FINE_MM = 0.12  # what varies over less is noise, and texture that no model of smooth light has
RINGS = {"inside": (0.0, 0.8), "rim": (0.8, 1.2), "around": (1.2, CONTACT_DISC)}


def parts(folder: Path, presses: tuple[int, ...]) -> dict[str, float]:
    """Mean squares over photographs that are not among the presses, levels^2."""
    data = GelRecording.load(Recording.load(folder))
    pairs = [data.samples[k] for k in presses]
    gel = fit_presses(pairs, data.px_per_mm, None, data.thickness_mm).gel
    predictor = Predictor(gel, pairs)
    others = [s for i, s in enumerate(data.samples) if i not in presses]
    each = [_parts_of(s, gel, predictor, data) for s in others]
    return {name: float(np.mean([e[name] for e in each])) for name in each[0]}


def _parts_of(s: GelSample, gel, predictor: Predictor, data: GelRecording) -> dict[str, float]:
    sensor, photograph = TactileSensor(replace(gel, rest_image=s.rest)), s
    m = disc(s.rest.shape, s.x_px, s.y_px, CONTACT_DISC * s.radius_px)
    y, x = np.mgrid[: m.shape[0], : m.shape[1]] + 0.5
    r = np.hypot(x - s.x_px, y - s.y_px) / s.radius_px
    predicted = predictor.image(s.press, s.rest, s.clock).astype(np.float32)
    left = s.image - predicted
    out = {"all": np.square(left[m]).mean()}
    for name, (low, high) in RINGS.items():
        here = m & (r >= low) & (r < high)
        out[f"place: {name}"] = np.square(left[here]).sum() / (3 * m.sum())
        out[f"level: {name}"] = np.square(left[here]).mean()
    out |= {
        f"colour: {c}": np.square(left[m][:, k]).mean() / 3 for k, c in enumerate(("red", "green", "blue"))
    }
    smooth = cv2.GaussianBlur(left, (0, 0), FINE_MM * data.px_per_mm)
    out["fine"] = np.square((left - smooth)[m]).mean()
    moved = predicted - s.rest  # levels that the contact adds, and the drift that is expected
    bright = np.where(moved > 0, 1.0, 0.0)
    out["where it gets brighter"] = (np.square(left[m]) * bright[m]).mean()

    def gone(name: str, image: np.ndarray) -> None:
        out[f"gone: {name}"] = out["all"] - np.square((s.image - np.clip(image, 0, 255))[m]).mean()

    off = left[m].mean(0)
    gone("mean level of each colour", predicted + off)
    drift = optics.upsample(session_light(photograph, data.px_per_mm), *s.rest.shape[:2])
    own = sensor.image(press_depth(s.press, gel)) + drift
    gone("the drift that it shows away from the contact", own)
    factors = [
        (left[m][:, k] @ moved[m][:, k]) / max(np.square(moved[m][:, k]).sum(), 1e-9) for k in range(3)
    ]
    gone("strength of each colour", predicted + moved * factors)

    def at(v: np.ndarray) -> np.ndarray:
        press = replace(
            s.press,
            x_mm=s.press.x_mm + v[0],
            y_mm=s.press.y_mm + v[1],
            depth_mm=s.press.depth_mm * np.exp(v[2]),
        )
        return predictor.image(press, s.rest, s.clock)

    start = np.vstack([np.zeros(3), np.diag([0.08, 0.08, 0.08])])
    options = {"initial_simplex": start, "maxfev": 60, "xatol": 0.005, "fatol": 0.02}
    found = minimize(
        lambda v: np.square((s.image - at(v).astype(float))[m]).mean(),
        np.zeros(3),
        method="Nelder-Mead",
        options=options,
    )
    gone("place and depth of the press", at(found.x).astype(np.float32))
    out["place off by, mm, squared"] = float(found.x[:2] @ found.x[:2])
    out["depth off by, share, squared"] = float(found.x[2] ** 2)
    for sigma in (0.05, 0.1):
        gone(f"blur of {sigma} mm", cv2.GaussianBlur(predicted, (0, 0), sigma * data.px_per_mm))
    fit = fit_presses([photograph], data.px_per_mm, None, data.thickness_mm)
    itself = Predictor(fit.gel, []).image(s.press, s.rest, s.clock) + drift
    gone("light fitted to itself", itself)
    return out


def main() -> None:
    """Prints a column a set: roots of mean squares, and shares of the mean square."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("PNEUTAC_DATA", "data")) / "tactile")
    parser.add_argument("--presses", type=int, default=5)
    parser.add_argument("--sets", type=int, default=8, help="random sets of several presses")
    parser.add_argument("--jobs", type=int, default=None, help="processes; as many as cores by default")
    options = parser.parse_args()
    folders = sorted(p.parent for p in options.data.glob("*/recording.json"))
    tried = []
    for folder in folders:
        count = len(GelRecording.load(Recording.load(folder)).samples)
        tried += [(folder, c) for c in choices(options.presses, count, options.sets)]
    with ProcessPoolExecutor(options.jobs) as pool:
        found = list(pool.map(parts, *zip(*tried, strict=True)))
    columns = {}
    for folder in folders:
        mine = [f for (of, _), f in zip(tried, found, strict=True) if of == folder]
        columns[folder.name] = {k: float(np.mean([f[k] for f in mine])) for k in mine[0]}
    print("| | " + " | ".join(columns) + " |\n|---|" + "---|" * len(columns))
    for name in found[0]:
        cells = [
            f"{np.sqrt(c[name]):.3g}"
            if name.startswith(("all", "level", "place off", "depth off"))
            else f"{c[name] / c['all']:.0%}"
            for c in columns.values()
        ]
        print(f"| {name.removesuffix(', squared')} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
