"""Surfaces of a ball, closed and outwards, and of a finger's particles."""

import numpy as np
import pytest

from pneutac_benchmarks.baselines.isosurface import isosurface
from pneutac_benchmarks.baselines.textured_mesh import surface
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.shapes import finger_mesh


@pytest.mark.parametrize("steps", [20, 40])
def test_ball_has_its_volume_and_area(steps):
    spacing = 2.6 / steps
    axis = -1.3 + spacing * np.arange(steps + 1)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    ball = isosurface(1 - np.sqrt(x**2 + y**2 + z**2), 0.0, spacing, np.full(3, -1.3))
    assert ball.is_watertight and ball.is_winding_consistent
    # a polyhedron between the ball's surface and a cell below it: second order
    assert ball.volume == pytest.approx(4 / 3 * np.pi, rel=2.5 * spacing**2)
    assert np.abs(np.linalg.norm(ball.vertices, axis=1) - 1).max() < spacing**2


def test_surface_of_a_body_is_closed_and_of_its_size():
    body = Body.from_mesh("finger", finger_mesh(0.11, 0.02), Material(1e6, 0.4), particles=2000)
    mesh = surface(body)
    assert mesh.is_watertight and mesh.volume == pytest.approx(body.volume_m3, rel=0.05)
    np.testing.assert_allclose(mesh.bounds, [[0, -0.01, -0.01], [0.11, 0.01, 0.01]], atol=1.2e-3)
