"""The texture of a rubber body from a printer, with a touch sensor at its tip."""

import cv2
import numpy as np

from pneutac_sim.mpm.shapes import PITCH_M


def printed_texture(rng: np.random.Generator, length_m: float) -> np.ndarray:
    """Texture of a printed body: layers, dirty folds, a label, a tape, and a sensor's housing at its tip.

    Args:
        rng: decides colours and places.
        length_m: of the straight body.

    Returns:
        uint8 (V, U, 3): columns along the body, rows round its axis from +y to +z.
    """
    rows, columns = 512, 1536
    hue = rng.uniform(0, 180)
    base = cv2.cvtColor(np.uint8([[[hue, rng.uniform(70, 150), rng.uniform(90, 150)]]]), cv2.COLOR_HSV2RGB)
    x = (np.arange(columns) + 0.5) / columns  # along
    angle = 2 * np.pi * (np.arange(rows) + 0.5) / rows

    def cloud(scale):
        seeds = rng.normal(size=(rows // scale + 2, columns // scale + 2))
        return cv2.resize(seeds, (columns, rows), interpolation=cv2.INTER_CUBIC)

    rings = max(1, round(length_m / PITCH_M))
    fold = 0.5 + 0.5 * np.cos(2 * np.pi * rings * x)
    light = 1 + 0.10 * cloud(128) + 0.05 * cloud(24) + 0.03 * rng.normal(size=(rows, columns))
    light += 0.035 * np.sin(2 * np.pi * x * length_m / 0.0006)  # layers of the printer
    light *= 1 - 0.30 * np.clip(0.6 + np.sin(angle), 0, 1)[:, None] * fold**3  # dirt in the folds
    picture = base[0, 0] * light[..., None]
    picture += cloud(64)[..., None] * rng.normal(0, 7, 3)  # uneven dye
    back = np.sin(angle) < -0.55  # the spine at the flat side is of a stiffer, paler rubber
    picture[back] = 0.55 * picture[back] + 0.45 * rng.uniform(90, 170)

    def patch(at, along, round_from, round_to, colour):
        i = (angle > round_from) & (angle < round_to)
        j = np.abs(x - at) < along / 2
        picture[np.ix_(i, j)] = colour

    front = 1.5 * np.pi, np.pi  # the side towards -y lies at the angle pi
    at = rng.uniform(0.18, 0.34)
    paper, ink = rng.uniform(205, 235, 3), rng.uniform(20, 60, 3)
    patch(at, 0.13, 0.90 * front[1], 1.12 * front[1], paper)
    for k in range(5):
        patch(at - 0.045 + 0.022 * k, 0.009, 0.94 * front[1], (1.0 + 0.015 * k) * front[1], ink)
    stripe = cv2.cvtColor(np.uint8([[[(hue + 90) % 180, 190, 200]]]), cv2.COLOR_HSV2RGB)[0, 0]
    patch(rng.uniform(0.52, 0.68), 0.025, 0, 2 * np.pi, stripe)  # a band of tape all round
    housing = cv2.cvtColor(np.uint8([[[(hue + 60) % 180, 120, rng.uniform(50, 90)]]]), cv2.COLOR_HSV2RGB)
    tip = x > 1 - 0.021 / length_m
    picture[:, tip] = housing[0, 0] * (1 + 0.04 * cloud(64)[:, tip, None])
    patch(1 - 0.007 / length_m, 0.008 / length_m, 0.15 * np.pi, 0.85 * np.pi, rng.uniform(180, 230, 3))  # gel
    return np.clip(picture, 4, 250).astype(np.uint8)
