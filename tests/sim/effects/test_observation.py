"""Observation effects: rigid motions and perspective."""

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_sim.effects import get_effect

TIPS = np.array([[110.0, 0, 0, 0, 0], [90.0, 5, 40, 0.8, 0.1], [60.0, -5, 80, 1.5, -0.1]])


def tilt(**values):
    zero = {k: v.value for k, v in get_effect("base_tilt").neutral().items()}
    return get_effect("base_tilt").apply(TIPS, np.ones(3), zero | values)


def camera(x=TIPS, **values):
    zero = {k: v.value for k, v in get_effect("camera_misalignment").neutral().items()}
    return get_effect("camera_misalignment").apply(x, np.ones(len(x)), zero | values, np.full(len(x), 110.0))


def test_tilt_is_a_rigid_motion():
    y = tilt(pitch_rad=0.1, yaw_rad=-0.2, roll_rad=0.3, shift_x_mm=5.0, shift_y_mm=-2.0, shift_z_mm=1.0)
    R = (
        Rotation.from_euler("x", 0.3) * Rotation.from_euler("z", -0.2) * Rotation.from_euler("y", -0.1)
    )  # pitch turns x to z: about -y
    np.testing.assert_allclose(y[:, :3], R.apply(TIPS[:, :3]) + [5, -2, 1], atol=1e-12)


def test_pitch_adds_to_the_bend_angle_at_every_pressure():
    np.testing.assert_allclose(tilt(pitch_rad=0.1)[:, 3] - TIPS[:, 3], 0.1)


def test_camera_roll_turns_the_picture_about_the_middle_of_the_finger():
    y = camera(roll_rad=0.2)
    c = TIPS[:, [0, 2]] - [55, 0]
    turned = c @ np.array([[np.cos(0.2), np.sin(0.2)], [-np.sin(0.2), np.cos(0.2)]])
    np.testing.assert_allclose(y[:, [0, 2]] - [55, 0], turned, atol=1e-12)


def test_a_camera_further_away_than_thought_shrinks_the_picture():
    flat = TIPS.copy()
    flat[:, 1] = 0
    y = camera(flat, shift_y_mm=50.0)
    np.testing.assert_allclose(y[:, [0, 2]] - [55, 0], (flat[:, [0, 2]] - [55, 0]) * 500 / 550, atol=1e-9)


def test_pan_brings_perspective_that_no_tilt_has():
    """Equal steps on the finger are no longer equal in the picture."""
    line = np.zeros((3, 5))
    line[:, 0] = [5.0, 55.0, 105.0]
    y = camera(line, pan_rad=0.3)
    steps = np.diff(y[:, 0])
    assert abs(steps[1] / steps[0] - 1) > 0.02
