"""Pictures of the benchmark: answers against the truth, and how far each error fell."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

BLUE, RED, GREY, INK, EMPTY = (11, 110, 153), (184, 68, 47), (154, 165, 177), "#1b2430", (246, 248, 250)
FULL = 32.0  # times the floor at the right edge of the ladder


def confusion(pairs: Sequence[tuple[str, str, bool]], last: Sequence[str]) -> np.ndarray:
    """Truth (rows) against answer (columns), uint8 (H, W, 3); share of each row by colour.

    Args:
        pairs: truth, answer and whether it is right, one for each recording.
        last: answers that name no effect; they stand at the right.
    """
    rows = list(dict.fromkeys(p[0] for p in pairs))
    given = {p[1] for p in pairs}
    columns = [r for r in rows if r in given] + sorted(given - set(rows) - set(last)) + list(last)
    count = np.zeros((len(rows), len(columns)), int)
    good = np.zeros_like(count)
    for truth, answer, right in pairs:
        i, j = rows.index(truth), columns.index(answer)
        count[i, j] += 1
        good[i, j] += right
    cell, left, top = 30, 190, 190
    image = Image.new("RGB", (left + cell * len(columns) + 10, top + cell * len(rows) + 10), "white")
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(13)
    for i, row in enumerate(rows):
        draw.text((left - 8, top + cell * (i + 0.5)), row, fill=INK, font=font, anchor="rm")
        for j in range(len(columns)):
            share = count[i, j] / max(count[i].sum(), 1)
            full = BLUE if good[i, j] else RED
            colour = tuple(round(255 - share * (255 - c)) for c in full) if count[i, j] else EMPTY
            x, y = left + cell * j, top + cell * i
            draw.rectangle((x + 1, y + 1, x + cell - 1, y + cell - 1), fill=colour)
            if count[i, j]:
                ink = "white" if share > 0.5 else INK
                draw.text((x + cell / 2, y + cell / 2), str(count[i, j]), fill=ink, font=font, anchor="mm")
    for j, name in enumerate(columns):
        label = Image.new("RGB", (top - 10, 18), "white")
        ImageDraw.Draw(label).text((0, 9), name, fill=INK, font=font, anchor="lm")
        image.paste(label.rotate(90, expand=True), (left + cell * j + 6, 4))
    return np.asarray(image)


def ladder(rows: Sequence[tuple[str, float, float]], near: float) -> np.ndarray:
    """Error before (grey) and after (blue within reach of the floor, else red), uint8 (H, W, 3).

    Args:
        rows: truth, errors before and after over the noise floor, which is the left line.
        near: error over the floor that counts as near, the dashed line.
    """
    line, left, width, top = 20, 200, 520, 34
    image = Image.new("RGB", (left + width + 30, top + line * len(rows) + 10), "white")
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(13)
    small = ImageFont.load_default(11)

    def at(ratio: float) -> float:
        return left + width * float(np.clip(np.log(ratio) / np.log(FULL), -0.02, 1.0))

    for ratio in (1, 2, 4, 8, 16, 32):
        draw.line(
            (at(ratio), top - 4, at(ratio), top + line * len(rows)), fill=INK if ratio == 1 else "#dde2e7"
        )
        draw.text((at(ratio), top - 8), f"{ratio}", fill=INK, font=small, anchor="mb")
    draw.text((left - 8, top - 8), "error / noise", fill=INK, font=small, anchor="rb")
    for y in range(top, top + line * len(rows), 8):
        draw.line((at(near), y, at(near), y + 4), fill=RED)
    for i, (name, before, after) in enumerate(rows):
        y, colour = top + line * (i + 0.5), BLUE if after <= near else RED
        draw.text((left - 8, y), name, fill=INK, font=font, anchor="rm")
        draw.line((at(after), y, at(before), y), fill=GREY, width=2)
        for ratio, fill in ((before, GREY), (after, colour)):
            draw.ellipse((at(ratio) - 4, y - 4, at(ratio) + 4, y + 4), fill=fill)
    return np.asarray(image)
