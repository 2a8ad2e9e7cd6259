"""Pictures of triangles and disks whose pixels are known."""

import numpy as np
import pytest

from pneutac_sim.baselines.zbuffer import draw_disks, draw_triangles
from pneutac_sim.splat.camera import Camera

SEE = Camera(np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]]), np.eye(4), 64, 48)
RED, BLUE = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])


def square(half, z):
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def test_a_square_fills_its_pixels_and_no_others():
    vertices, faces = square(0.1, 1.0)  # 20 x 20 px
    image, alpha = draw_triangles(SEE, vertices, faces, np.tile(RED, (4, 1)))
    assert alpha.sum() == pytest.approx(400, abs=1)
    np.testing.assert_allclose(image[14:34, 22:42], np.broadcast_to(RED, (20, 20, 3)), atol=1e-6)
    assert image[:13].max() == 0


def test_the_nearest_is_on_top_in_any_order():
    near, faces = square(0.05, 1.0)
    far, _ = square(0.2, 2.0)
    for order in (1, -1):
        parts = [(near, RED), (far, BLUE)][::order]
        vertices = np.concatenate([v for v, _ in parts])
        colours = np.concatenate([np.tile(c, (4, 1)) for _, c in parts])
        image, _ = draw_triangles(SEE, vertices, np.concatenate([faces, faces + 4]), colours)
        np.testing.assert_allclose(image[24, 32], RED, atol=1e-6)
        np.testing.assert_allclose(image[24, 40], BLUE, atol=1e-6)


def test_colours_are_linear_in_space_not_in_the_picture():
    corners = np.array([[-0.1, -0.2, 1.0], [0.3, -0.2, 3.0], [0.3, 0.2, 3.0], [-0.1, 0.2, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    image, _ = draw_triangles(SEE, corners, faces, np.array([RED, BLUE, BLUE, RED]))
    x = 32.5  # this pixel's ray x = 0.005 z meets the plane x = -0.1 + 0.2 (z - 1)
    ray = (x - 32) / 100
    z = 0.3 / (0.2 - ray)
    assert image[24, 32, 2] == pytest.approx((z - 1) / 2, abs=0.01)


def test_disks_have_their_radius_and_the_nearest_wins():
    image, alpha = draw_disks(SEE, np.array([[0, 0, 1.0], [0, 0, 2.0]]), 0.1, np.array([RED, BLUE]))
    assert alpha.sum() == pytest.approx(np.pi * 100, rel=0.02)
    np.testing.assert_allclose(image[24, 32], RED)
    behind = draw_disks(SEE, np.array([[0, 0, -1.0]]), 0.1, RED[None])
    assert behind.alpha.max() == 0
