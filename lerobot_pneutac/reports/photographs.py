"""The report of a calibration by images: photographs beside renderings, and how the objective fell."""

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from lerobot_pneutac.reports.page import Report
from pneutac_sim.photo_fit.objective import SILHOUETTE, SOLID, Objective, Photograph

UNIT = "8-bit levels"
HEIGHT = 220  # px of a picture


def outcome(found) -> dict:
    """What `result.json` tells of a `PhotoFit`."""
    sure, scores = found.confidence, found.scores
    loss = scores.appearance[0] + SILHOUETTE * (1 - scores.iou[0])
    rows = {}
    for name, unit, value in zip(
        found.parameters.names, found.parameters.units, found.parameters.values(found.search.x), strict=True
    ):
        unclear = name in sure.not_identified
        note = "not identified: open by more than a tenth of its range" if unclear else ""
        rows[name] = {"value": float(value), "ci95": list(sure.ci95[name]), "unit": unit, "note": note}

    def parts(values):
        return {"train": found.mean(values, True), "heldout": found.mean(values, False)}

    result = {
        "parameters": rows,
        "error": parts(scores.rmse[0]),
        "unit": UNIT,
        "objective": parts(loss),
        "iou": parts(scores.iou[0]),
        "not_identified": sure.not_identified,
        "coarse": dict(
            zip(found.parameters.names, found.parameters.values(found.start.x).tolist(), strict=True)
        ),
        "cameras": found.session.cameras[: found.session.fitted],
        "train_kpa": found.session.pressures[found.session.train].tolist(),
        "evaluations": len(found.search.objectives),
        "resumed": found.search.resumed,
        "seconds": found.seconds,
    }
    if found.tip_error_mm is not None:
        square = found.tip_error_mm**2
        kept = {"train": found.session.train, "heldout": ~found.session.train}
        result["tip_error_mm"] = {
            k: float(np.sqrt(square[m].mean())) if m.any() else None for k, m in kept.items()
        }
    return result


def strip(objective: Objective, positions: np.ndarray, photographs: list[Photograph]) -> np.ndarray:
    """Photographs above, renderings below and differing silhouettes last, uint8 (H, W, 3).

    Args:
        objective: draws.
        positions: (T, P, 3) of the particles at each pressure, m.
        photographs: their `state` counts `positions`.
    """
    columns = []
    low, high = _crop(photographs)
    for p in photographs:
        drawn = objective.render(positions[p.state], p.camera)
        white = drawn.image.clip(0, 1) + (1 - drawn.alpha.clip(0, 1))[..., None]
        edges = differing(p.mask, drawn.alpha > SOLID)
        real = np.where(p.mask[..., None], p.image, 255)
        stack = [a[low[0] : high[0], low[1] : high[1]] for a in (real, 255 * white.clip(0, 1), edges)]
        size = (round(HEIGHT * (high[1] - low[1]) / (high[0] - low[0])), HEIGHT)
        columns.append(
            np.concatenate(
                [cv2.resize(a.astype(np.uint8), size, interpolation=cv2.INTER_AREA) for a in stack]
            )
        )
    return np.concatenate(columns, 1)


def differing(photograph: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Two silhouettes, bool (H, W): grey where both are, red where the photograph's alone, blue the other's.

    Returns:
        uint8 (H, W, 3), on white.
    """
    image = np.full((*photograph.shape, 3), 255, np.uint8)
    image[photograph & drawn] = (222, 226, 230)
    image[photograph & ~drawn] = (194, 65, 12)
    image[~photograph & drawn] = (11, 110, 153)
    return image


def _crop(photographs: list[Photograph]) -> tuple[np.ndarray, np.ndarray]:
    """Corners (row, column) of a window round all masks."""
    corners = [np.argwhere(p.mask) for p in photographs]
    size = np.array(photographs[0].mask.shape)
    low = np.min([c.min(0) for c in corners], 0) - 12
    high = np.max([c.max(0) for c in corners], 0) + 12
    return np.maximum(low, 0), np.minimum(high, size)


def photo_report(found, result: dict) -> Report:
    """The page of a `PhotoFit` and its `result.json`."""
    import plotly.graph_objects as go

    page = Report(f"Calibrated {found.twin.device} by images")
    iou, tip = result["iou"], result.get("tip_error_mm")
    lead = f"Silhouettes overlap by {iou['train']:.1%} where the twin was fitted"
    if iou["heldout"] is not None:
        lead += f" and by {iou['heldout']:.1%} at pressures that it has not seen"
    if tip is not None and tip["heldout"] is not None:
        lead += f"; there its tip misses the marker, which was not fitted, by {tip['heldout']:.2g} mm"
    page.lead(lead + ".")
    page.table(
        [
            {"parameter": n, "value": r["value"], "95 % interval": "{:.4g} to {:.4g}".format(*r["ci95"])}
            | {"unit": r["unit"], "note": r["note"]}
            for n, r in result["parameters"].items()
        ],
        "Intervals tell how sharply the silhouettes fix each parameter. A body whose shape or neutral axis "
        "is not the twin's shifts all of them together, by more than that.",
    )
    session = found.session
    page.heading("Photographs and renderings")
    page.text(
        "Above the photograph, below the twin; then red where only the photograph, blue where only the twin."
    )
    shown = sorted(range(len(session.photographs)), key=lambda i: session.photographs[i].state)
    for i in range(0, len(shown), 6):
        some = [session.photographs[k] for k in shown[i : i + 6]]
        if len({p.mask.shape for p in some}) > 1:
            continue
        kind = [
            f"{'/'.join(f'{v:g}' for v in session.pressures[p.state])} kPa"
            f"{'' if session.train[p.state] else ' (held out)'}"
            for p in some
        ]
        page.image(strip(found.objective, found.bodies.positions[0], some), ", ".join(kind))
    page.heading("How the objective fell")
    tried = found.search.objectives
    figure = go.Figure()
    figure.add_scatter(y=tried, mode="markers", name="candidates", marker={"color": "#9aa5b1"})
    figure.add_scatter(y=np.minimum.accumulate(tried), mode="lines", name="best", line={"color": "#0b6e99"})
    page.figure(figure.update_xaxes(title="evaluation").update_yaxes(title="L1 + 2 (1 - IoU)", type="log"))
    return page


def show(found, result: dict, console: Console) -> None:
    """Prints a `PhotoFit` and its `result.json` as a table and a sentence."""
    table = Table("parameter", "value", "95 % interval", "unit", "note")
    for name, r in result["parameters"].items():
        interval = f"{r['ci95'][0]:.4g} to {r['ci95'][1]:.4g}"
        table.add_row(
            name, f"{r['value']:.4g}", interval, r["unit"], r["note"], style="yellow" if r["note"] else None
        )
    console.print(table)
    iou, tip = result["iou"], result.get("tip_error_mm")
    held = "nothing was held out" if iou["heldout"] is None else f"held-out IoU {iou['heldout']:.4f}"
    if tip is not None and tip["heldout"] is not None:
        length = found.twin.length_mm
        held += (
            f", held-out tip error {tip['heldout']:.3g} mm ({100 * tip['heldout'] / length:.2g} % of length)"
        )
    taken = f" ({result['resumed']} of them from before)" if result["resumed"] else ""
    console.print(
        f"IoU {iou['train']:.4f} where it was fitted, {held}; {result['evaluations']} evaluations{taken} in "
        f"{found.seconds:.0f} s; the twin at {result['twin']} is now version {result['version']}",
        highlight=False,
    )
