"""`pneutac benchmark body --part=looks`: the paper's Table I, pictures of a soft finger from one photograph.

Each method gets the same particles and one segmented photograph of the un-actuated finger from the front. It
then renders the finger at every pressure, from the front and from the back, where it has never looked.
"""

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import Progress

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.body.options import BenchmarkBodyConfig
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_datasets.recording.photographs import read_camera, read_photograph
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.splat.body import carried, fit_body_looks
from pneutac_sim.splat.render import rasterise
from pneutac_sim.twin import Twin, Value

VIEWS = ("front", "back")
OURS = ("PneuTac", "PneuTac, 3 x 3 x 3")
BASELINES = ("Tex-Mesh", "Par-Splat", "Def-NeRF")
PAPER = {  # mean and SEM of its Table I, on photographs that are not public
    "PneuTac": ((50.07, 0.83), (77.61, 11.72)),
    "Tex-Mesh": ((51.13, 1.12), (79.09, 9.08)),
    "Par-Splat": ((54.58, 1.59), (78.62, 8.43)),
    "Def-NeRF": ((55.06, 11.72), (68.96, 12.77)),
}


def methods(fast: bool) -> dict:
    """Name to a function of body, positions, gradients, image, mask, camera that gives a fitted renderer."""
    from pneutac_benchmarks.baselines.deformable_nerf import DeformableNerf
    from pneutac_benchmarks.baselines.particle_splat import ParticleSplat
    from pneutac_benchmarks.baselines.textured_mesh import TexturedMesh

    nerf = partial(DeformableNerf.fit, iterations=100) if fast else DeformableNerf.fit
    ours = Splatted.fit, partial(Splatted.fit, detail=3, iterations=150 if fast else 600)
    fits = (*ours, TexturedMesh.fit, ParticleSplat.fit, nerf)
    return dict(zip((*OURS, *BASELINES), fits, strict=True))


@dataclass(frozen=True)
class Splatted:
    """Our Gaussians under the methods' common face."""

    body: object
    looks: object

    @classmethod
    def fit(cls, body, positions, gradients, image, mask, camera, **options) -> "Splatted":
        """From one photograph."""
        return cls(body, fit_body_looks(body, positions, gradients, image, mask, camera, **options))

    def image(self, positions, gradients, camera):
        """The body in another state."""
        return rasterise(carried(self.looks, self.body, positions, gradients), camera)


def rmse(image: np.ndarray, alpha: np.ndarray, photograph: np.ndarray, mask: np.ndarray) -> float:
    """Of 8-bit levels over the pixels where either silhouette is, both pictures on black.

    Args:
        image: rendered on black (H, W, 3), 0 to 1.
        alpha: its coverage (H, W); its silhouette is where that is above a half.
        photograph: uint8 (H, W, 3).
        mask: bool (H, W).
    """
    union = mask | (alpha > 0.5)
    wanted = np.where(mask[..., None], photograph, 0).astype(float)
    return float(np.sqrt(np.mean((255 * image.clip(0, 1) - wanted)[union] ** 2)))


def benchmark_looks(cfg: BenchmarkBodyConfig) -> dict:
    """Takes the photographs, fits and scores every method, and writes table, pictures and `result.json`.

    Returns:
        What `result.json` holds: `rows`, one a method, body, view and pressure; `table`, mean and SEM over
        bodies and pressures, without the pressure that was trained on from the front.
    """
    console, rows, strips, folder = Console(), [], [], cfg.out / "looks"
    fits = methods(cfg.fast)
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("photographs", total=cfg.bodies * len(fits))
        for seed in range(cfg.first_seed, cfg.first_seed + cfg.bodies):
            scene = photographs(cfg, seed, folder)
            strip = []
            for name, fit in fits.items():
                bar.update(task, description=f"body {seed}: {name}")
                for row, picture in score(name, fit, *scene):
                    rows.append({"body": seed} | row)
                    strip.append(picture)
                bar.advance(task)
            strips.append(grid(list(fits), strip, scene[3]))
    result = {
        "unit": "8-bit levels, root mean square over the union of silhouettes, on black",
        "trained_on": "front view at 0 kPa",
        "bodies": cfg.bodies,
        "rows": rows,
        "table": summary(rows),
    }
    write_result(folder, result)
    Image.fromarray(np.concatenate(strips)).save(folder / "pictures.png", optimize=True)
    write_table(result, folder, console)
    return result


def photographs(cfg: BenchmarkBodyConfig, seed: int, out: Path) -> tuple:
    """Body, its states at every pressure, cameras and photographs of one hidden finger.

    The particles move as those of a twin with the true parameters would, so that rendering alone is compared.
    """
    from pneutac_datasets.generate.photographs import write_photographs
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.mpm.total_lagrangian import Loads

    pressures = np.arange(0, 15 + 1e-9, cfg.step_kpa)
    folder = out / f"photographs_{seed}_{cfg.step_kpa:g}kpa"
    if not (folder / "recording.json").is_file():
        write_photographs(folder, seed, pressures_kpa=pressures)
    recording = Recording.load(folder)
    truth = json.loads((folder.parent / "truth" / f"{folder.name}.json").read_text())["parameters"]
    parameters = {k: Value(v) for k, v in truth.items()}
    twin = Twin("finger", recording.length_mm, recording.spine_joint_positions_mm, parameters)
    solver = devices.finger(twin, batch=len(pressures), particles=cfg.particles)
    state = solve_equilibrium(solver, Loads(q_cmd=devices.joint_targets(twin, pressures)))
    cameras = {view: read_camera(recording, view) for view in VIEWS}
    shots = {v: [read_photograph(recording, i, v) for i in range(len(pressures))] for v in VIEWS}
    return solver.body, state, cameras, shots, pressures


def score(name, fit, body, state, cameras, shots, pressures) -> Iterator[tuple[dict, np.ndarray]]:
    """One row and one picture (uint8, on white) for each view and pressure."""
    start = time.perf_counter()
    renderer = fit(body, state.positions[0], state.gradients[0], *shots["front"][0], cameras["front"])
    fitted = time.perf_counter() - start
    for view in VIEWS:
        for i, pressure in enumerate(pressures):
            start = time.perf_counter()
            image, alpha = renderer.image(state.positions[i], state.gradients[i], cameras[view])
            row = {
                "method": name,
                "view": view,
                "pressure_kpa": float(pressure),
                "trained": view == "front" and i == 0,
                "rmse": rmse(image, alpha, *shots[view][i]),
                "fit_s": fitted,
                "render_s": time.perf_counter() - start,
            }
            shown = image.clip(0, 1) + (1 - alpha.clip(0, 1))[..., None]
            yield row, (255 * shown).clip(0, 255).astype(np.uint8)


def summary(rows: list[dict]) -> list[dict]:
    """One row a method: mean and SEM over bodies and pressures of each view."""
    out = []
    for name in dict.fromkeys(r["method"] for r in rows):
        line = {"method": name}
        mine = [r for r in rows if r["method"] == name]
        for view in VIEWS:
            values = [r["rmse"] for r in mine if r["view"] == view and not r["trained"]]
            line[view] = float(np.mean(values))
            line[f"{view}_sem"] = float(np.std(values, ddof=len(values) > 1) / np.sqrt(len(values)))
        line["fit_s"] = float(np.median([r["fit_s"] for r in mine]))
        line["render_s"] = float(np.median([r["render_s"] for r in mine]))
        out.append(line)
    return out


def write_table(result: dict, out: Path, console: Console) -> None:
    """Prints the table and writes `table.md`."""
    heads = ("method", "front", "back", "fit, s", "picture, s", "paper: front", "paper: back")
    rows = []
    for r in result["table"]:
        cells = [r["method"], *(f"{r[v]:.2f} ± {r[f'{v}_sem']:.2f}" for v in VIEWS)]
        cells += [f"{r['fit_s']:.1f}", f"{r['render_s']:.3f}"]
        cells += [f"{m:.2f} ± {s:.2f}" for m, s in PAPER[r["method"]]] if r["method"] in PAPER else ["-", "-"]
        rows.append(cells)
    console.print(terminal(f"RMSE, {result['unit']}; mean ± SEM", heads, rows))
    lines = [
        *markdown(heads, rows),
        "",
        f"Unit: {result['unit']}. Trained on one photograph, {result['trained_on']}; the means leave it out.",
        "The paper's numbers are of its own photographs and not comparable by their size.",
    ]
    (out / "table.md").write_text("\n".join(lines) + "\n")
    console.print(f"table: {out / 'table.md'}, pictures: {out / 'pictures.png'}", highlight=False)


def grid(names: list[str], pictures: list[np.ndarray], shots: dict) -> np.ndarray:
    """Rows: photograph, then each method; columns: lowest, middle and highest pressure, front and back."""
    real = [np.where(mask[..., None], image, 255).astype(np.uint8) for v in VIEWS for image, mask in shots[v]]
    count = len(shots["front"])
    columns = [k + c for k in (0, count) for c in (0, count // 2, count - 1)]
    all_pictures = np.stack(real + pictures).reshape(-1, 2 * count, *real[0].shape)[:, columns]
    lines = []
    for name, line in zip(["photograph", *names], all_pictures, strict=True):
        small = [cv2.resize(p[:, 80:560], (240, 240), interpolation=cv2.INTER_AREA) for p in line]
        strip = np.concatenate(small, 1)
        cv2.putText(strip, name, (6, 232), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (27, 36, 48), 1, cv2.LINE_AA)
        lines.append(strip)
    return np.concatenate(lines)
