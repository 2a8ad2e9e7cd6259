"""Punches with an outline and meshes: the same depths as the plain shapes where they are the same."""

import numpy as np
import pytest
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.gel.figure import Figure, Outline
from pneutac_sim.gel.indenter import Press
from pneutac_sim.mpm.figure import centre_m, distances_m, half_edge_m
from pneutac_sim.world.mpm_gel import signed_distance

SQUARE = Outline(((-2, -2), (2, -2), (2, 2), (-2, 2)))


def test_a_square_outline_is_a_cube_on_its_face():
    for yaw in (0.0, 0.6):
        plain = Press("cube", 4.0, 1.0, -2.0, 0.5, yaw)
        punch = Press("outline", 0.0, 1.0, -2.0, 0.5, yaw, SQUARE)
        np.testing.assert_allclose(punch.depths(), plain.depths(), atol=1e-6)
        assert punch.contact_radius_mm == pytest.approx(plain.contact_radius_mm)


def test_a_leaning_punch_is_deeper_on_the_side_that_it_leans_to():
    lean = {"tilt_x_rad": 0.04, "tilt_y_rad": -0.03}
    cube = Press("cube", 4.0, 1.0, -2.0, 0.5, 0.6, **lean).depths()
    punch = Press("outline", 0.0, 1.0, -2.0, 0.5, 0.6, SQUARE, **lean).depths()
    upright = Press("cube", 4.0, 1.0, -2.0, 0.5, 0.6).depths()
    x, y = np.meshgrid((np.arange(59) + 0.5) * 12 / 59 - 7, (np.arange(80) + 0.5) * 16 / 80 - 6)
    wanted = np.where(upright > 0, 0.5 + np.tan(0.04) * x - np.tan(0.03) * y, 0)
    assert np.ptp(wanted[upright > 0]) > 0.15
    np.testing.assert_allclose(punch, wanted, atol=1e-6)
    assert np.median(np.abs(cube - punch)[upright > 0]) < 1e-3 and ((cube > 0) != (punch > 0)).mean() < 0.002


def test_a_mesh_of_a_ball_is_a_ball():
    ball = Figure(trimesh.creation.icosphere(4, 3.0).triangles + [0.0, 0.0, 40.0])
    plain, mesh = Press("sphere", 3.0, -1.0, 2.0, 0.8), Press("mesh", 0.0, -1.0, 2.0, 0.8, 0.3, ball)
    np.testing.assert_allclose(mesh.depths(), plain.depths(), atol=0.012)
    assert mesh.contact_radius_mm == pytest.approx(np.sqrt(0.8 * (6 - 0.8)), rel=0.05), (
        "where it meets the plane"
    )
    assert mesh.size_mm == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0 2; 2 -1", "three corners"),
        ("0 2; 2 -1; -2", "give corners in mm"),
        ("triangle", "give corners in mm"),
        ("-2 -2; 2 2; 2 -2; -2 2", "crosses itself: side 1 meets side 3"),
        ("-2 0; 0 0; 2 0", "no area"),
        ("1 1; 3 1; 2 3", "beside its origin"),
        ("0 2; 2 nan; -2 -1", "three corners"),
    ],
)
def test_impossible_outlines_get_one_sentence(text, says):
    with pytest.raises(InputError, match=says) as e:
        Outline.of_text(text)
    assert "\n" not in str(e.value)


def test_impossible_figures_get_one_sentence():
    metres = trimesh.creation.box((0.004, 0.004, 0.004)).triangles
    for bad, says in ((metres, "give it in mm"), (1e3 * metres + [9.0, 0, 0], "beside its origin")):
        with pytest.raises(InputError, match=says):
            Figure(bad)
    with pytest.raises(InputError, match="needs a figure"):
        Press("mesh", 3.0, 0, 0, 0.5)
    with pytest.raises(InputError, match="has no figure"):
        Press("cube", 3.0, 0, 0, 0.5, 0, SQUARE)
    with pytest.raises(InputError, match="none of the shapes"):
        Press("outline", 0, 0, 0, 0.5, 0, SQUARE).shapes()


@pytest.mark.parametrize("mesh", [False, True])
def test_the_distances_for_material_points_are_those_of_a_box(mesh):
    box = Figure(trimesh.creation.box((4, 4, 40)).triangles) if mesh else SQUARE
    table = distances_m(box)
    line = np.linspace(-1, 1, len(table)) * half_edge_m(box)
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3) + centre_m(box)
    known = signed_distance(6, np.array([2e-3, 2e-3, 20e-3]), points - [0, 0, 20e-3])
    assert np.abs(table.ravel() - known).max() < (1e-4 if mesh else 1e-9)
