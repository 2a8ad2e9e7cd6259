"""Pictures of triangles and disks whose pixels are known."""

import numpy as np
import pytest
import trimesh

from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.zbuffer import cover, draw_triangles

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


def test_coverage_is_the_area_of_a_triangle_and_of_a_ball():
    corners = np.array([[-0.1, -0.08, 1.0], [0.15, -0.02, 1.0], [0.03, 0.11, 1.0]])  # 100 px/m at 1 m
    a, b = 100 * (corners[1] - corners[0])[:2], 100 * (corners[2] - corners[0])[:2]
    area = 0.5 * abs(a[0] * b[1] - a[1] * b[0])
    covered = cover(SEE, corners, np.array([[0, 1, 2]]))
    assert covered.sum() == pytest.approx(area, rel=5e-3)
    assert np.allclose(covered, cover(SEE, corners, np.array([[0, 2, 1]])))  # from behind too
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.15)
    covered = cover(SEE, ball.vertices + [0.0, 0.0, 1.0], ball.faces)
    tangent = 0.15**2 / (1 - 0.15**2)  # of the cone that touches it, squared
    assert covered.sum() == pytest.approx(np.pi * 100**2 * tangent, rel=5e-3)
    assert covered.max() == 1.0
