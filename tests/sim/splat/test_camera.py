import cv2
import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera

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
        ({"intrinsics": -K}, "intrinsics"),
        ({"extrinsics": 2 * np.eye(4)}, "rotation"),
        ({"width": 0}, "width"),
        ({"height": 2.5}, "height"),
        ({"distortion": (0.1, 0.2)}, "distortion"),
        ({"distortion": (0.1, np.nan, 0, 0)}, "distortion"),
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
