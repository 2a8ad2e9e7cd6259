"""Calibrates the gel of a twin to a bench recording, scores it on held-out images and reports."""

import time

import numpy as np
from PIL import Image
from rich.console import Console
from rich.table import Table

from lerobot_pneutac.benchmarks.baselines.pasted import Pasted
from lerobot_pneutac.reports.page import Report, write_result
from lerobot_pneutac.study.gel import at_bound
from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.optics import OPTICS, SENSOR
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel.fit import fit_gel
from pneutac_sim.gel.metrics import ImageScores, score
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import Pair
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.twin import Twin

OURS, PASTED, REST = "this model", "difference pasted", "rest image"
PICTURES = 6  # held-out images in the picture grid


def calibrate_gel(twin: Twin, recording: Recording, cfg, console: Console) -> dict:
    """Fits, saves the twin's next version, prints the table, writes result, pictures and report.

    Args:
        twin: a twin of a gel, or of a finger that gets this gel.
        recording: of a gel, with one row of role `calibration`.
        cfg: `CalibrateConfig`.
        console: where the table goes.

    Returns:
        The content of `result.json`.
    """
    data = GelRecording.load(recording)
    for warning in data.warnings[len(recording.warnings) :]:
        console.print(f"[yellow]note:[/] {warning}", highlight=False)
    sample = data.calibration
    start, effects = time.monotonic(), wanted(cfg.effects, twin)
    try:
        fit = fit_gel(
            sample.rest,
            sample.image,
            sample.press,
            data.px_per_mm,
            effects,
            data.thickness_mm,
        )
        gel, carried = fit.gel, for_twin(fit.gel, twin)
    except InputError as e:
        names = f"rest image '{recording.meta['rest_image']}', indentation '{sample.name}'"
        raise InputError(f"{recording.folder} ({names}): {e}") from e
    seconds = time.monotonic() - start

    images = render(gel, data)
    scores = {name: scores_of(data, predicted) for name, predicted in images.items()}
    heldout = [i for i, s in enumerate(data.samples) if s.role != "calibration"]
    trained = scores[OURS][data.samples.index(sample)]
    mean = (
        {name: ImageScores.mean([rows[i] for i in heldout]) for name, rows in scores.items()}
        if heldout
        else {}
    )
    unseen = [scores[OURS][i].rmse for i in heldout]
    error = {
        "train": trained.rmse,
        "heldout": float(np.sqrt(np.mean(np.square(unseen)))) if heldout else None,
    }

    # images generated for this run alone are gone after it, so their folder would tell nothing
    passing = cfg.recording is None and recording.meta.get("generated")
    source = f"generated images (seed {cfg.seed})" if passing else str(recording.folder)
    carried.into_twin(twin)
    twin.save_version(cfg.twin, "calibrated gel", source, {**error, "unit": "levels"})
    result = {
        "parameters": _parameters(carried),
        "error": error,
        "evaluations": fit.evaluations,
        "make": fit.make,
        "orientation": str(fit.orientation) if fit.make else "",
        "seconds": seconds,
        "image": (_finite(mean[OURS]) | {"rest_rmse": mean[REST].rmse, "n": len(heldout)})
        if heldout
        else None,
        "methods": {name: _finite(m) for name, m in mean.items()},
        "recording": source,
        "notes": recording.meta.get("notes", ""),
        "twin": str(cfg.twin),
        "version": twin.history[-1]["version"],
    }
    rows = _table(data, scores)
    _print(rows, console)
    if fit.make:
        console.print(f"The light is that of a {fit.make}, {fit.orientation}.", highlight=False)
    console.print(
        f"Fitted to one rest and one indentation image in {seconds:.1f} s; "
        f"the twin at {cfg.twin} is now version {result['version']}.",
        highlight=False,
    )
    if heldout and mean[OURS].rmse > mean[REST].rmse:
        console.print(
            "[yellow]note:[/] on held-out images the model is worse than the rest image alone: check where "
            "and how deep the rows say that the indenter pressed."
        )
    for name in at_bound(carried, list(carried.effects)):
        console.print(f"[yellow]note:[/] {name} lies at its bound.", highlight=False)
    if not heldout:
        console.print(
            "[yellow]note:[/] there is no held-out image, so nothing tells how well this generalises."
        )
    if cfg.out is not None:
        write_result(cfg.out, result)
        picture = picture_grid(data, images[OURS], sample)
        Image.fromarray(picture).save(cfg.out / "tactile.png")
        console.print(f"Report: {_report(cfg, result, rows, picture)}", highlight=False)
    return result


def for_twin(gel: GelModel, twin: Twin) -> GelModel:
    """The gel at the size in which the twin keeps it: 240 x 320, other proportions for a lone gel only."""
    h, w = gel.rest_image.shape[:2]
    if twin.device == "gel" and abs(w / h / (IMAGE_SHAPE[1] / IMAGE_SHAPE[0]) - 1) > 0.02:
        return gel
    return gel.resized(*IMAGE_SHAPE[:2])


def wanted(effects: str | None, twin: Twin) -> list[str]:
    """Optics effects to fit: those asked for, else those of the twin, else those of a sensor.

    Raises:
        InputError: a name is no optics effect, or acts on a session and not on one pair.
    """
    if effects is None:
        return [e for e in twin.effects if e in OPTICS] if twin.gel else list(SENSOR)
    names = [] if effects == "none" else [name.strip() for name in effects.split(",")]
    for name in names:
        if name not in SENSOR:
            why = "needs more than one pair of images" if name in OPTICS else "is no optics effect"
            raise InputError(
                f"--effects={effects}: '{name}' {why}; give some of {','.join(SENSOR)}, or none for the "
                "paper's linear model."
            )
    return list(dict.fromkeys(names))


def predict(gel: GelModel, data: GelRecording) -> list[np.ndarray]:
    """Predicted image of every sample; the calibration pair tells how the light drifts."""
    pair = next((s.photograph for s in data.samples if s.role == "calibration"), None)
    predictor = Predictor(gel, pair)
    return [predictor.image(s.press, s.rest, s.clock) for s in data.samples]


def render(gel: GelModel, data: GelRecording) -> dict[str, list[np.ndarray]]:
    """Predictions of every sample by the model and by the two rows that keep one honest."""
    c = data.calibration
    pasted = Pasted.fit(Pair(c.rest, c.image, c.press, data.px_per_mm))
    return {
        OURS: predict(gel, data),
        PASTED: [pasted.image(s.press) for s in data.samples],
        REST: [s.rest for s in data.samples],
    }


def scores_of(data: GelRecording, predicted: list[np.ndarray]) -> list[ImageScores]:
    """Each sample's prediction against its photograph."""
    return [
        score(p, s.image, s.rest, s.x_px, s.y_px, s.radius_px)
        for p, s in zip(predicted, data.samples, strict=True)
    ]


def _finite(scores: ImageScores) -> dict:
    """Scores as plain numbers; the PSNR of equal images, which is infinite, as None."""
    return {k: v if np.isfinite(v) else None for k, v in vars(scores).items()}


def _parameters(gel: GelModel) -> dict:
    """Name to value and unit of what was fitted."""
    out = {}
    for k, channel in enumerate("rgb"):
        for axis in range(2):
            out[f"light_{channel}_{'xy'[axis]}"] = {"value": gel.light[k, axis], "unit": "levels"}
        out[f"depth_light_{channel}"] = {"value": gel.depth_light[k], "unit": "levels/mm"}
    out["decay_mm"] = {"value": gel.decay_mm, "unit": "mm"}
    out["depth_scale"] = {"value": gel.depth_scale, "unit": ""}
    for effect, values in gel.effects.items():
        units = {p.name: p.unit for p in OPTICS[effect].parameters}
        out |= {f"{effect}.{k}": {"value": round(v, 6), "unit": units[k]} for k, v in values.items()}
    out["threshold_levels"] = {"value": gel.threshold_levels, "unit": "levels"}
    return out


def _table(data: GelRecording, scores: dict[str, list[ImageScores]]) -> list[dict]:
    """One row a method and role, held-out roles first."""
    rows = []
    for role in sorted({s.role for s in data.samples}, key=lambda r: (r == "calibration", r)):
        picked = [i for i, s in enumerate(data.samples) if s.role == role]
        for name, each in scores.items():
            m = ImageScores.mean([each[i] for i in picked])
            row = {"images": f"{role or 'others'} ({len(picked)})", "method": name}
            row |= {"RMSE": m.rmse, "PSNR": m.psnr, "NCC": m.ncc}
            rows.append(row | {"contact": m.contact_rmse, "dNCC": m.contact_dncc})
    return [r for r in rows if not (r["method"] == PASTED and r["images"].startswith("calibration"))]


def _print(rows: list[dict], console: Console) -> None:
    table = Table(title="Rendered against the recording's tactile images (8-bit levels)")
    for name in rows[0]:
        table.add_column(name, justify="left" if name in ("images", "method") else "right")
    last = None
    for row in rows:
        if last is not None and row["images"] != last:
            table.add_section()
        shown, last = "" if row["images"] == last else row["images"], row["images"]
        cells = [
            f"{v:.3f}" if "NCC" in k else f"{v:.2f}" if isinstance(v, float) else v for k, v in row.items()
        ]
        table.add_row(shown, *cells[1:], style="bold" if row["method"] == OURS else None)
    console.print(table)


def picture_grid(data: GelRecording, ours: list[np.ndarray], first: GelSample) -> np.ndarray:
    """Rows recorded, ours, error (grey is none, four times exaggerated); columns rest, first, held-out."""
    heldout = [i for i, s in enumerate(data.samples) if s.role != "calibration"]
    picks = (
        [heldout[i] for i in np.unique(np.linspace(0, len(heldout) - 1, PICTURES).astype(int))]
        if heldout
        else []
    )
    columns = [_column(data.rest, data.rest)]
    columns += [_column(data.samples[i].image, ours[i]) for i in [data.samples.index(first), *picks]]
    return np.concatenate(columns, axis=1)


def _column(recorded: np.ndarray, ours: np.ndarray) -> np.ndarray:
    error = np.clip(128 + 4.0 * (ours.astype(float) - recorded), 0, 255).astype(np.uint8)
    size = (round(160 * recorded.shape[1] / recorded.shape[0] * 4 / 3), round(160 * 4 / 3))
    small = [
        np.asarray(Image.fromarray(a).resize(size, Image.Resampling.BOX)) for a in (recorded, ours, error)
    ]
    return np.pad(
        np.concatenate([np.pad(a, ((0, 4), (0, 0), (0, 0)), constant_values=255) for a in small]),
        ((0, 0), (0, 4), (0, 0)),
        constant_values=255,
    )


def _report(cfg, result: dict, rows: list[dict], picture: np.ndarray):
    report = Report("A tactile sensor from two images")
    image = result["image"]
    if image:
        report.lead(
            f"On {image['n']} images that the fit has not seen, the error is {image['rmse']:.2f} levels; "
            f"the rest image alone has {image['rest_rmse']:.2f}."
        )
    report.text(f"Recording: `{result['recording']}`. {result['notes']}")
    report.image(
        picture,
        "Above the recording, in the middle the model, below model minus recording (four times; grey is no "
        "error). "
        "Columns: rest, the calibration image, held-out images.",
    )
    report.table(
        rows,
        "Mean over images; contact: a disc of twice the contact radius; dNCC: correlation of "
        "(image - rest) there.",
    )
    report.heading("What was fitted")
    report.table(
        [{"parameter": k, **v} for k, v in result["parameters"].items()],
        "Light per unit slope along x (columns) and y (rows) and per millimetre of depth",
    )
    report.heading("Do it again")
    command = f"pneutac calibrate --twin={cfg.twin} --seed={cfg.seed}"
    report.code(
        command
        + (f" --effects={cfg.effects}" if cfg.effects else "")
        + (f" --recording={cfg.recording}" if cfg.recording else "")
        + f" --out={cfg.out}"
    )
    return report.write(cfg.out)
