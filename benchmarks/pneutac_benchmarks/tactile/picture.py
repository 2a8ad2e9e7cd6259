"""Photographs, what each method predicts of them, and its error, in one picture."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pneutac_benchmarks.tactile.methods import METHODS
from pneutac_benchmarks.tactile.sets import TactileSet, thumbnail

ROWS = ("model", "linear", "taxim", "tacchi", "dot_sim")
COLUMNS = 5
EXAGGERATED = 4.0
LABEL_PX, GAP_PX = 120, 4


def columns(images: list[dict]) -> list[int]:
    """Images spread evenly over the ranks of a row's error, from the least to the largest."""
    order = np.argsort([i["rmse"] for i in images], kind="stable")
    return [int(order[i]) for i in np.unique(np.linspace(0, len(order) - 1, COLUMNS).astype(int))]


def picture_grid(chosen: TactileSet, rows: dict[str, dict], thumbs: dict[str, np.ndarray]) -> Image.Image:
    """Rows: photograph, then each method's picture and, below it, its error (four times; grey is none).

    Args:
        chosen: the set.
        rows: method key to row of `measure`; columns follow the error of ours, or of the first one.
        thumbs: method key to small pictures (n, h, w, 3), one a held-out image.
    """
    keys = [k for k in ROWS if k in thumbs] or list(thumbs)
    picks = columns(rows[keys[0]]["images"])
    photographs = [thumbnail(chosen.heldout[i].image) for i in picks]
    strips = [("photograph", photographs)]
    for k in keys:
        predicted = [thumbs[k][i] for i in picks]
        strips.append((METHODS[k].name, predicted))
        strips.append(("its error x 4", [_error(p, r) for p, r in zip(predicted, photographs, strict=True)]))
    height, width = photographs[0].shape[:2]
    size = LABEL_PX + len(picks) * (width + GAP_PX), len(strips) * (height + GAP_PX)
    out, font = Image.new("RGB", size, "white"), ImageFont.load_default(12)
    draw = ImageDraw.Draw(out)
    for row, (label, images) in enumerate(strips):
        top = row * (height + GAP_PX)
        draw.text((LABEL_PX - 6, top + height // 2), label, fill="#1b2430", font=font, anchor="rm")
        for column, image in enumerate(images):
            out.paste(Image.fromarray(image), (LABEL_PX + column * (width + GAP_PX), top))
    return out


def _error(image: np.ndarray, photograph: np.ndarray) -> np.ndarray:
    return np.clip(128 + EXAGGERATED * (image.astype(float) - photograph), 0, 255).astype(np.uint8)
