"""Compares a gel twin with recorded images: scores, also of the contact alone, and the worst images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console

from lerobot_pneutac.reports.page import Report, write_result
from lerobot_pneutac.verbs.fit_gel import picture_grid, predict, scores_of
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import slope_light
from pneutac_sim.gel.layout import Layout, Orientation, recognise
from pneutac_sim.gel.metrics import ImageScores, disc
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

QUIET_RADII = 3.0  # beyond so many contact radii the image should equal the rest image
WORST = 5


def compare_gel(twin: Twin, recording: Recording, out: Path | None, console: Console) -> dict:
    """Renders every image's indentation with the twin, scores and reports.

    The recording's own rest images, scale and, if it has a row of role `calibration`, half of the drift of
    light seen there are used: illumination changes between sessions, and that is no fault of the gel's model.

    Returns:
        The content of `result.json`.
    """
    data = GelRecording.load(recording)
    if not twin.gel:
        raise InputError(
            "The twin has no gel; calibrate it with `pneutac calibrate` on a recording of a gel."
        )
    gel = seen_by(GelModel.from_twin(twin), data)
    data.warnings += turned(gel, data)
    ours = predict(gel, data)
    scores, rest = scores_of(data, ours), scores_of(data, [s.rest for s in data.samples])
    train = np.array([s.role == "calibration" for s in data.samples])
    held = [i for i in range(len(scores)) if not train[i]]
    result = {
        "unit": "levels",
        "error": {"train": _rms(scores, train), "heldout": _rms(scores, ~train)},
        "noise_floor": _floor(data),
        "noise": {
            "how": f"change of the picture further than {QUIET_RADII:g} contact radii from the contact"
        },
        "image": _image(scores, rest, held),
        "by": {
            "role": _by(scores, [s.role or "others" for s in data.samples]),
            "indenter": _by([scores[i] for i in held], [data.samples[i].press.indenter for i in held]),
        },
        "worst": [
            {"image": data.samples[i].name, "error": scores[i].rmse, "contact_rmse": scores[i].contact_rmse}
            for i in sorted(range(len(scores)), key=lambda i: -scores[i].contact_rmse)[:WORST]
        ],
        "history": [
            {k: e.get(k) for k in ("version", "change", "train", "heldout", "unit")} for e in twin.history
        ],
        "checks": data.warnings,
    }
    result["sentence"] = sentence = _sentence(result)
    console.print(f"[bold]{sentence}[/bold]", highlight=False)
    for said in data.warnings:
        console.print(f"[yellow]- {said}[/yellow]", highlight=False)
    if out is not None:
        write_result(out, result)
        first = data.samples[int(np.argmax(train))]
        picture = picture_grid(data, ours, first)
        Image.fromarray(picture).save(out / "tactile.png")
        report = Report(f"Gel twin against recording: {recording.folder.name}")
        report.lead(sentence)
        report.image(picture, "Above the recording, in the middle the twin, below four times the difference.")
        if result["image"]:
            report.table([result["image"]], "Means over the images whose role is not calibration.")
        for name, rows in result["by"].items():
            report.table(rows, f"By {name}.")
        report.table(result["worst"], "Worst images.")
        console.print(f"report: {report.write(out)}", highlight=False)
    return result


def seen_by(gel: GelModel, data: GelRecording) -> GelModel:
    """The same gel in a recording's images: their rest image, scale and thickness."""
    own = {"rest_image": data.rest, "px_per_mm": data.px_per_mm, "thickness_mm": data.thickness_mm}
    return replace(gel, **own)


def turned(gel: GelModel, data: GelRecording) -> list[str]:
    """A note where the recording's images are mirrored, or have their channels in another order."""
    pair = next((s.photograph for s in data.samples if s.role == "calibration"), None)
    if pair is None:
        return []
    far = -1e3 * gel.light / np.maximum(np.linalg.norm(gel.light, axis=1), 1e-9)[:, None]
    height, width = data.rest.shape[:2]
    own = Layout("twin", tuple(map(tuple, far)), (0.0, 0.0, 0.0), width / height)
    light = slope_light(replace(gel, effects={}), pair)
    orientation = recognise(light, pair.press.x_mm, pair.press.y_mm, (width, height), own)
    if orientation is None or orientation == Orientation():
        return []
    return [
        f"against the twin the recording's images are {orientation}; turn them, or calibrate a twin of "
        "their own."
    ]


def _image(scores: list[ImageScores], rest: list[ImageScores], held: list[int]) -> dict | None:
    if not held:
        return None
    mean = ImageScores.mean([scores[i] for i in held])
    # two equal pictures have an infinite PSNR, which JSON cannot hold; 8-bit rounding ends at 59 dB
    psnr = {"psnr": min(mean.psnr, 99.0)}
    return vars(mean) | psnr | {"rest_rmse": ImageScores.mean([rest[i] for i in held]).rmse, "n": len(held)}


def _rms(scores: list[ImageScores], mask: np.ndarray) -> float | None:
    """Root mean square over the chosen images."""
    chosen = [s.rmse**2 for s, m in zip(scores, mask, strict=True) if m]
    return float(np.sqrt(np.mean(chosen))) if chosen else None


def _by(scores: list[ImageScores], labels: list[str]) -> list[dict]:
    rows = []
    for label in sorted(set(labels)):
        mean = ImageScores.mean([s for s, x in zip(scores, labels, strict=True) if x == label])
        row = {"value": label, "error": mean.rmse, "n": labels.count(label)}
        rows.append(row | {"contact_rmse": mean.contact_rmse, "contact_dncc": mean.contact_dncc})
    return rows


def _floor(data: GelRecording) -> float:
    """What the picture changes where nothing touches, levels: light, noise and compression."""
    squares = []
    for s in data.samples:
        quiet = ~disc(s.rest.shape, s.x_px, s.y_px, QUIET_RADII * s.radius_px)
        if quiet.any():
            squares.append(np.mean((s.image[quiet].astype(float) - s.rest[quiet]) ** 2))
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def _sentence(result: dict) -> str:
    image = result["image"]
    if image is None:
        error = result["error"]["train"]
        return f"The twin misses its calibration image by {error:.3g} levels; the recording has no other."
    return (
        f"On {image['n']} images that the twin was not fitted to it is {image['rmse']:.3g} levels off "
        f"(the rest image alone {image['rest_rmse']:.3g}), in the contact {image['contact_rmse']:.3g}."
    )
