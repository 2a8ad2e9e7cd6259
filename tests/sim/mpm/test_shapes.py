"""Parametric bodies: closed, of the volume that geometry gives, and as much of it in particles."""

import numpy as np
import pytest

from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.solid import (
    DIGIT_HALF_HEIGHT_M,
    DIGIT_LENGTH_M,
    MOUNT_OVERLAP_M,
    MOUNT_PLAY_M,
    MOUNT_WALL_M,
    arm_mesh,
    body_mesh,
    digit_mount_mesh,
    finger_mesh,
)
from pneutac_sim.twin import Twin, Value

RUBBER = Material(1e6, 0.45)


def superellipse_area(half: float) -> float:
    """Area of y^4 + z^4 = half^4, from an inscribed polygon that is far finer than any mesh here."""
    a = np.linspace(0, 2 * np.pi, 100_001)
    r2 = half**2 / np.sqrt(np.cos(a) ** 4 + np.sin(a) ** 4)
    return float(0.5 * np.sum((r2[1:] + r2[:-1]) / 2 * np.diff(a)))


def test_the_fingers_spine_is_flat_and_its_ends_are_full():
    mesh = finger_mesh(0.11, 0.02)
    assert mesh.is_watertight and mesh.is_winding_consistent
    whole = 0.11 * superellipse_area(0.01)
    assert 0.75 * whole < mesh.volume < 0.95 * whole  # less the folds
    x, z = mesh.vertices[:, 0], mesh.vertices[:, 2]
    rings = np.unique(x.round(9))
    np.testing.assert_allclose([z[np.isclose(x, s)].min() for s in rings], -0.01)  # the back
    tops = np.array([z[np.isclose(x, s)].max() for s in rings])
    assert tops.max() == pytest.approx(0.01) and tops.min() == pytest.approx(0.0078, rel=0.02)


def test_the_gel_lies_under_its_window():
    twin = Twin("gel", 16.0)
    GelModel.builtin().into_twin(twin)
    mesh = body_mesh(twin)
    model = GelModel.from_twin(twin)
    w, h = (1e-3 * side for side in model.window_mm)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(1e-3 * model.thickness_mm * w * h, rel=1e-9)
    assert mesh.bounds[1] == pytest.approx([w / 2, h / 2, 0])


@pytest.mark.parametrize("width", [0.02, 0.03])
def test_the_mount_holds_the_housing_beside_the_finger(width):
    mesh = digit_mount_mesh(0.11, width)
    assert mesh.is_watertight and mesh.is_winding_consistent
    wall, play, half = MOUNT_WALL_M, MOUNT_PLAY_M, width / 2
    floor = (width + 2 * (play + wall)) * wall
    cheeks = 2 * wall * DIGIT_HALF_HEIGHT_M
    length = MOUNT_OVERLAP_M + DIGIT_LENGTH_M
    assert mesh.volume == pytest.approx(length * (floor + cheeks), rel=1e-9)
    # nothing of it lies within the finger, whose back it touches but for the play
    body = (np.abs(mesh.vertices[:, 1:]) < half + 0.99 * play).all(1)
    assert not body.any()


@pytest.mark.parametrize(("shape", "length"), [(finger_mesh, 0.11), (arm_mesh, 0.2)])
def test_particles_hold_the_volume_and_are_as_many_as_asked(shape, length):
    mesh = shape(length, {0.11: 0.02, 0.2: 0.04}[length])
    body = Body.from_mesh("body", mesh, RUBBER, particles=4000, clamp="x-")
    assert len(body.cells) * body.spacing_m**3 == pytest.approx(mesh.volume, rel=0.05)
    assert len(body.cells) == pytest.approx(4000, rel=0.05)


def test_a_twins_body_has_the_twins_length_and_width():
    twin = Twin("arm", 150.0, parameters={"width_mm": Value(30.0)})
    assert body_mesh(twin).bounds[1] == pytest.approx([0.15, 0.013, 0.015], abs=1.5e-3)
    finger = body_mesh(Twin.builtin())
    np.testing.assert_array_equal(finger.vertices, finger_mesh(0.11, 0.02).vertices)
