"""Points that follow particles: affine deformations exactly, bending to second order of the spacing.

Masks from photographs against the renderer's own.
"""

import cv2
import numpy as np
import pytest
import trimesh

from pneutac_datasets.recording.photographs import segment
from pneutac_sim.errors import InputError
from pneutac_sim.photo_fit.objective import cover
from pneutac_sim.splat.body import Carrier
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Splats, fit_looks, solve_colours

K = np.array([[300.0, 0, 161], [0, 310.0, 118], [0, 0, 1]])


def test_looks_at_its_target():
    camera = Camera.look_at([1.0, 2.0, 0.5], [0, 0, 0], [0, 0, 1], 50, 320, 240)
    pixels, depth = camera.project([[0, 0, 0], [0, 0, 0.1], [0.2, -0.1, 0]])
    assert np.allclose(pixels[0], [160, 120])
    assert depth[0] == pytest.approx(np.sqrt(5.25))
    assert pixels[1, 0] == pytest.approx(160)
    assert pixels[1, 1] < 120  # up is up
    assert pixels[2, 0] < 160  # left of the view is left
    top = np.array([0, 0, 1]) * np.tan(np.radians(25)) * depth[0]
    tall = Camera.look_at([depth[0], 0, 0], [0, 0, 0], [0, 0, 1], 50, 320, 240)
    assert tall.project([top])[0][0, 1] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("lens", [(), (-0.3, 0.1, 0.002, -0.001), (-0.3, 0.1, 0.002, -0.001, 0.05)])
def test_projects_as_opencv_does(lens):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.3, 0.3, (50, 3)) + [0, 0, 1]
    rotation, shift = np.array([0.1, -0.2, 0.3]), np.array([0.02, 0.03, 0.1])
    E = np.eye(4)
    E[:3, :3], E[:3, 3] = cv2.Rodrigues(rotation)[0], shift
    theirs = cv2.projectPoints(points, rotation, shift, K, np.array(lens))[0][:, 0]
    assert np.allclose(Camera(K, E, 320, 240, lens).project(points)[0], theirs, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"intrinsics": np.eye(2)}, "intrinsics"),
        ({"intrinsics": K * np.nan}, "intrinsics"),
        ({"extrinsics": 2 * np.eye(4)}, "rotation"),
        ({"width": 0}, "width"),
        ({"distortion": (0.1, 0.2)}, "distortion"),
    ],
)
def test_bad_cameras_are_refused(change, said):
    with pytest.raises(InputError, match=said):
        Camera(**{"intrinsics": K, "extrinsics": np.eye(4), "width": 320, "height": 240, **change})


def test_bad_views_are_refused():
    with pytest.raises(InputError, match="one line"):
        Camera.look_at([0, 0, 1], [0, 0, 0], [0, 0, 1], 50, 320, 240)
    with pytest.raises(InputError, match="one line"):
        Camera.look_at([0, 0, 1], [0, 0, 1], [0, 1, 0], 50, 320, 240)
    with pytest.raises(InputError, match="fov_y_deg"):
        Camera.look_at([0, 1, 1], [0, 0, 0], [0, 0, 1], 180, 320, 240)
    with pytest.raises(InputError, match="points|Points"):
        Camera.look_at([0, 1, 1], [0, 0, 0], [0, 0, 1], 50, 320, 240).project([[0, np.nan, 0]])


def lattice(spacing):
    axes = (np.arange(0, 0.04, spacing), np.arange(0, 0.012, spacing), np.arange(0, 0.012, spacing))
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def test_affine_motion_is_met_exactly_also_outside():
    rng = np.random.default_rng(0)
    rest = lattice(0.002)
    F = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    points = rng.uniform(-0.004, 0.045, (200, 3))
    gradients = np.broadcast_to(F, (len(rest), 3, 3))
    moved = Carrier(points, rest)(rest @ F.T + [1, 2, 3], gradients)
    np.testing.assert_allclose(moved, points @ F.T + [1, 2, 3], atol=1e-12)


def bend(points, radius=0.03):
    """Rolls a bar up: x becomes the angle, z the distance from the middle line."""
    angle, r = points[:, 0] / radius, radius - points[:, 2]
    return np.stack([r * np.sin(angle), points[:, 1], radius - r * np.cos(angle)], -1)


def gradient(points, radius=0.03):
    angle, r = points[:, 0] / radius, radius - points[:, 2]
    F = np.zeros((len(points), 3, 3))
    F[:, 0, 0], F[:, 0, 2] = r / radius * np.cos(angle), -np.sin(angle)
    F[:, 2, 0], F[:, 2, 2] = r / radius * np.sin(angle), np.cos(angle)
    F[:, 1, 1] = 1
    return F


def test_bending_converges_with_the_spacing():
    points = np.random.default_rng(1).uniform([0.004, 0.002, 0.002], [0.034, 0.009, 0.009], (300, 3))
    errors = []
    for spacing in (0.002, 0.001):
        rest = lattice(spacing)
        moved = Carrier(points, rest)(bend(rest), gradient(rest))
        errors.append(np.linalg.norm(moved - bend(points), axis=1).max())
    assert errors[0] < 1e-4
    assert errors[1] < 0.35 * errors[0]


BACKGROUND = (0.1, 0.6, 0.3)


def sheet(layers: int = 1):
    """Camera, means and covariances of layers of 24 x 18 Gaussians two pixels apart, seen head-on."""
    x, y, z = np.meshgrid(np.arange(24), np.arange(18), np.arange(layers), indexing="ij")
    means = np.stack([x * 2.0 + 1, y * 2.0 + 1, 100 + z], -1).reshape(-1, 3) * 1e-3
    camera = Camera(np.array([[100.0, 0, 0], [0, 100.0, 0], [0, 0, 1]]), np.eye(4), 48, 36)
    return camera, means, np.tile(np.eye(3) * 1e-6, (len(means), 1, 1))


def rmse(a, b):
    return float(np.sqrt(np.mean(np.square(a - b))))


@pytest.mark.slow
def test_direct_solution_recovers_known_colours():
    camera, means, covariances = sheet()
    known = np.random.default_rng(0).random((len(means), 3))
    splats = Splats(camera, means, covariances, np.full(len(means), 0.7))
    found = solve_colours(splats, splats.render(known, BACKGROUND).image, BACKGROUND, 60, ridge=1e-6)
    assert np.abs(found - known).max() < 0.02


@pytest.mark.slow
def test_coverage_is_fitted_to_a_silhouette():
    camera, means, covariances = sheet()
    wanted = np.zeros((36, 48))
    wanted[:, :24] = 1
    n = len(means)
    _, before = Splats(camera, means, covariances, np.full(n, 0.5)).render(np.zeros((n, 3)))
    target = np.zeros((36, 48, 3))
    splats = Splats(camera, means, covariances, np.full(n, 0.5))
    _, fitted = fit_looks(splats, target, iterations=300, coverage=wanted)
    _, after = Splats(camera, means, covariances, fitted).render(np.zeros((n, 3)))
    assert rmse(after, wanted) < 0.5 * rmse(before, wanted)


def test_bad_targets_are_refused():
    camera, means, covariances = sheet()
    splats = Splats(camera, means, covariances, np.full(len(means), 0.9))
    with pytest.raises(InputError, match="target"):
        solve_colours(splats, np.full((36, 48, 3), np.nan))
    with pytest.raises(InputError, match="target"):
        solve_colours(splats, np.zeros((48, 36, 3)))


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


@pytest.mark.slow
def test_bad_input_is_named(photographed):
    image, _ = photographed.pictures["front"][0]
    empty = photographed.background["front"]
    with pytest.raises(InputError, match="No body was found"):
        segment(empty, background=empty)
    with pytest.raises(InputError, match="same camera"):
        segment(image, background=empty[::2])


SEE = Camera(np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]]), np.eye(4), 64, 48)


def square(half, z):
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


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
