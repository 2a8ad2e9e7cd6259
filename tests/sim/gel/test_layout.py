"""Which way round a sensor's images are, told by the directions of its light."""

import itertools
import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pneutac_sim.gel import builtin
from pneutac_sim.gel.layout import (
    DIGIT,
    LIKE,
    MATCH_DEG,
    Orientation,
    orientations,
    recognise,
    recognise_rest,
)

EVERY = [
    Orientation(c, x, y)
    for c in itertools.permutations(range(3))
    for x, y in itertools.product((False, True), repeat=2)
]
PLACES = [(0.0, 0.0), (0.6, -1.0), (-2.0, 3.0), (2.0, 4.0)]
SIZE = (240, 320)


def light_of(layout, x_mm, y_mm):
    """L (3, 2) of a layout's lights at a place, of unlike strengths."""
    away = np.array([x_mm, y_mm]) - layout.positions_mm
    return away / np.linalg.norm(away, axis=1)[:, None] * np.array([[120.0], [80.0], [40.0]])


def mismatch_deg(layout, light, x_mm, y_mm):
    """Largest angle between the layout's directions and the light's."""
    a, b = light_of(layout, x_mm, y_mm), light
    cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))).max()


@pytest.mark.parametrize("x_mm, y_mm", PLACES)
def test_a_digits_own_directions_are_recognised(x_mm, y_mm):
    assert recognise(light_of(DIGIT, x_mm, y_mm), x_mm, y_mm, SIZE) == Orientation()


@pytest.mark.parametrize("orientation", EVERY, ids=str)
@pytest.mark.parametrize("x_mm, y_mm", PLACES)
def test_every_order_of_channels_and_mirroring_is_found(orientation, x_mm, y_mm):
    """Or upright, where the make's own orientation fits within the limit as well."""
    light = light_of(orientation.of(DIGIT), x_mm, y_mm)
    found = recognise(light, x_mm, y_mm, SIZE)
    if mismatch_deg(DIGIT, light, x_mm, y_mm) < MATCH_DEG:
        assert found == Orientation()
    else:
        assert found is not None and found == orientation


def test_the_directions_may_be_off_by_less_than_the_limit():
    for degrees, expected in ((MATCH_DEG - 5, Orientation()), (-MATCH_DEG + 5, Orientation())):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turned = light_of(DIGIT, 0, 0) @ np.array([[c, s], [-s, c]])
        assert recognise(turned, 0, 0, SIZE) == expected


@pytest.mark.parametrize("size", [(320, 320), (320, 240), (200, 320)])
def test_images_of_other_proportions_are_of_no_digit(size):
    assert recognise(light_of(DIGIT, 0, 0), 0, 0, size) is None


def test_other_directions_are_of_no_digit():
    assert recognise(np.full((3, 2), 50.0), 0, 0, SIZE) is None, "all lights on one side"
    a = np.radians([0, 180, 200])
    assert recognise(80 * np.stack([np.cos(a), np.sin(a)], -1), 0, 0, SIZE) is None, "two opposite"
    rng = np.random.default_rng(0)
    found = [recognise(rng.normal(size=(3, 2)), 0, 0, SIZE) for _ in range(400)]
    assert np.mean([f is not None for f in found]) < 0.1


def noisy(image, rng):
    """As another unit of the make shows it: brighter, with a tilt of its own and noise."""
    h, w, _ = image.shape
    y, x = np.mgrid[:h, :w] / np.array([h, w])[:, None, None] - 0.5
    image = 1.15 * image + 12 + (18 * x + 14 * y)[..., None] + rng.normal(0, 4, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("orientation", orientations(), ids=str)
def test_a_rest_image_tells_the_make_and_which_way_round_it_is(orientation):
    image = noisy(builtin.rest_image((320, 240, 3)), np.random.default_rng(0))
    found, alike = recognise_rest(np.ascontiguousarray(orientation.shown(image)))
    assert found == orientation and alike > LIKE


def test_other_rest_images_are_of_no_digit():
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:320, :240] / 320 - 0.5
    grey = np.full((320, 240, 3), 120, np.uint8)
    around = np.stack([np.hypot(x, y)] * 3, -1) * [250, 240, 230]
    for image in (grey, noisy(around, rng), rng.integers(0, 255, (320, 240, 3)).astype(np.uint8)):
        assert recognise_rest(image)[0] is None
    assert recognise_rest(builtin.rest_image((320, 320, 3)))[0] is None, "of other proportions"


def test_real_rest_images_are_told():
    folder = Path(os.environ.get("PNEUTAC_DATA", "")) / "tactile"
    if not os.environ.get("PNEUTAC_DATA") or not folder.is_dir():
        pytest.skip("PNEUTAC_DATA does not name a folder with real recordings")
    found = {}
    for name in ("digit_nagoya", "digit_fots", "gelsight_thu"):
        meta = json.loads((folder / name / "recording.json").read_text())
        rest = np.asarray(Image.open(folder / name / meta["rest_image"]).convert("RGB"))
        found[name] = recognise_rest(rest)[0]
    assert found == {"digit_nagoya": Orientation(), "digit_fots": Orientation(), "gelsight_thu": None}
