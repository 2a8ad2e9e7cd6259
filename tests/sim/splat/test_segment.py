"""Masks from photographs against the renderer's own."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_datasets.generate.photo_scene import Studio, photograph
from pneutac_datasets.generate.photographs import place_camera
from pneutac_sim.errors import InputError
from pneutac_sim.mpm.shapes import finger_mesh
from pneutac_sim.splat.segment import segment


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize("view", ["front", "back"])
@pytest.mark.slow
def test_difference_to_the_empty_scene_finds_the_body(photographed, view):
    for image, mask in photographed.pictures[view]:
        assert iou(segment(image, background=photographed.background[view]), mask) > 0.95


@pytest.mark.slow
def test_brighter_backdrop_is_no_body(photographed):
    """A cloud that passes between the two photographs."""
    image, mask = photographed.pictures["front"][0]
    background = (photographed.background["front"] * 0.97).astype(np.uint8)
    assert iou(segment(image, background=background), mask) > 0.9


@pytest.mark.parametrize("colour", [(190, 60, 50), (40, 110, 190)])
def test_colour_finds_a_body_of_one_colour(colour):
    rng = np.random.default_rng(1)
    mesh = finger_mesh(0.11, 0.02).subdivide()
    studio = replace(Studio.random(rng, 0.11, 0.02), texture=np.full((8, 8, 3), colour, np.uint8))
    camera = place_camera("front", 0.11, rng)
    image, mask = photograph(mesh, mesh.vertices, studio, camera, rng)
    assert iou(segment(image, colour=colour), mask) > 0.92


@pytest.mark.slow
def test_bad_input_is_named(photographed):
    image, _ = photographed.pictures["front"][0]
    empty = photographed.background["front"]
    with pytest.raises(InputError, match="either the background .* or the body's colour"):
        segment(image)
    with pytest.raises(InputError, match="either the background"):
        segment(image, background=empty, colour=(1, 2, 3))
    with pytest.raises(InputError, match="No body was found"):
        segment(empty, background=empty)
    with pytest.raises(InputError, match="same camera"):
        segment(image, background=empty[::2])
    with pytest.raises(InputError, match="The image must be RGB uint8"):
        segment(image.astype(float), background=empty)
    with pytest.raises(InputError, match="from 0 to 255"):
        segment(image, colour=(0.1, np.nan, 3))
