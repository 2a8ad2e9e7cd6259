"""Body effects: creep, softening, temperature, loads.

Observation effects: rigid motions and perspective.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation
from scipy.special import erf

from pneutac_sim.effects import get_effect
from pneutac_sim.effects.creep import TIMES_S
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.stages import Geometry

WEIGHTS = (0.1, 0.3, 0.0, 0.2, 0.4, 0.1)
NAMES = [p.name for p in get_effect("creep").parameters]
CREEP = dict(zip(NAMES, WEIGHTS, strict=True))


def apply(name, x, values, dt=0.05, conditions=None):
    return get_effect(name).apply(x, np.full(len(x), dt), values, conditions)


def test_creep_step_response_is_the_prony_series():
    dt = 0.01
    x = np.r_[0.0, np.full(20000, 1.0)]
    y = apply("creep", x, CREEP, dt)
    w = np.array(WEIGHTS)
    t = np.arange(20001) * dt
    # the sampled step is a ramp of one sample, so its middle lies half a sample before the second sample
    late = (1 - np.exp(-(t[:, None] - dt / 2) / np.array(TIMES_S))) @ w
    expected = (x + late) / (1 + w.sum())
    np.testing.assert_allclose(y[1:], expected[1:], atol=2e-4)


@pytest.mark.parametrize("tau", [0.5, 1.0, 3.0, 5.0, 17.0, 60.0, 130.0])
def test_the_grid_of_times_reproduces_any_time_constant(tau):
    t = np.geomspace(0.05, 600, 200)
    basis = np.exp(-t[:, None] / np.array(TIMES_S))
    w, _ = nnls(basis, np.exp(-t / tau))
    assert np.abs(basis @ w - np.exp(-t / tau)).max() < 0.05


def test_softening_below_the_maximum_follows_ogden_and_roxburgh():
    up_down_up = np.r_[np.linspace(0.01, 1, 50), np.linspace(1, 0.1, 50), np.linspace(0.1, 1.5, 70)]
    m, u = 0.3, 0.6
    values = {"below_maximum": m, "below_maximum_width": u, "per_cycle": 0.0, "cycles": 3.0}
    y = apply("cyclic_softening", up_down_up, values)
    largest = np.maximum.accumulate(up_down_up)
    np.testing.assert_allclose(y, up_down_up / (1 - m * erf((1 - (up_down_up / largest) ** 2) / u)))
    virgin = up_down_up == largest
    np.testing.assert_array_equal(y[virgin], up_down_up[virgin])  # new ground is as hard as ever
    assert (y[60:95] > up_down_up[60:95]).all()


def test_softening_grows_with_cycles_as_one_minus_exponential_and_survives_a_rest():
    cycle = np.r_[np.linspace(0, 1, 50), np.linspace(1, 0, 50)]
    x = np.tile(cycle, 8)
    values = {"below_maximum": 0.0, "below_maximum_width": 0.5, "per_cycle": 0.15, "cycles": 2.0}
    dt = np.full(len(x), 0.05)
    dt[400] = np.inf
    y = get_effect("cyclic_softening").apply(x, dt, values)
    peaks = y[49::100]
    n = np.arange(8) * 0.95  # a twentieth of the way back is not counted
    np.testing.assert_allclose(peaks, 1 + 0.15 * (1 - np.exp(-n / 2.0)), rtol=0.01)


def test_noise_is_not_counted_as_cycles():
    rng = np.random.default_rng(0)
    x = np.r_[np.linspace(0, 1, 50), 1 + 0.01 * rng.normal(size=2000)]
    values = {"below_maximum": 0.0, "below_maximum_width": 0.5, "per_cycle": 0.5, "cycles": 1.0}
    y = apply("cyclic_softening", x, values)
    assert abs(y[-200:].mean() / x[-200:].mean() - 1) < 0.05


def test_gravity_and_payload_add_weight_along_gravity():
    down = np.array([[0.0, 0, -1], [1.0, 0, 0]])
    loads = get_effect("gravity").apply(
        np.zeros((2, 6)), np.ones(2), {"body_mass_g": 100.0, "tip_mass_g": 20.0}, down
    )
    np.testing.assert_allclose(loads[0], [0, 0, -0.02 * 9.80665, 0, 0, -0.1 * 9.80665])
    np.testing.assert_allclose(loads[1], [0.02 * 9.80665, 0, 0, 0.1 * 9.80665, 0, 0])
    hung = get_effect("payload").apply(loads, np.ones(2), {"share": 1.0}, np.c_[[50.0, 0.0], down])
    np.testing.assert_allclose(hung[0] - loads[0], [0, 0, -0.05 * 9.80665, 0, 0, 0])
    np.testing.assert_array_equal(hung[1], loads[1])


TIPS = np.array([[110.0, 0, 0, 0, 0], [90.0, 5, 40, 0.8, 0.1], [60.0, -5, 80, 1.5, -0.1]])


def tilt(**values):
    zero = {k: v.value for k, v in get_effect("base_tilt").neutral().items()}
    return get_effect("base_tilt").apply(TIPS, np.ones(3), zero | values)


def camera(x=TIPS, **values):
    zero = {k: v.value for k, v in get_effect("camera_misalignment").neutral().items()}
    return get_effect("camera_misalignment").apply(x, np.ones(len(x)), zero | values, np.full(len(x), 110.0))


def test_a_curvature_read_off_the_tip_of_a_body_that_is_no_arc_is_one_number_off():
    theta, rigid = np.linspace(0.02, 1.2, 60), 0.25  # of the length, at the tip, which does not bend
    along = (1 - rigid) * np.sin(theta) / theta + rigid * np.cos(theta)
    aside = (1 - rigid) * (1 - np.cos(theta)) / theta + rigid * np.sin(theta)
    read = 2 * np.arctan2(aside, along)  # the chord of an arc lies at half its bend
    gain = (read @ theta) / (theta @ theta)
    terms = np.c_[theta, theta**3]
    (a, b), *_ = np.linalg.lstsq(terms, read, rcond=None)
    x = np.c_[np.zeros((60, 3)), 0.6 * a * theta, 0.8 * a * theta]
    seen = get_effect("curvature_reading").apply(x, np.ones(60), {"uneven_1_per_rad2": b / a**3})
    np.testing.assert_allclose(seen[:, 3] / seen[:, 4], 0.75)  # its direction is read as it is
    left = np.abs(np.hypot(seen[:, 3], seen[:, 4]) - read).max()
    assert left < 0.05 * np.abs(gain * theta - read).max()


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


def test_a_twist_turns_each_joint_by_its_place_and_the_mean_pressure():
    bends, pressure = np.tile([0.2, 0.0, 0.1, 0.3], (3, 1)), np.array([0.0, 1.0, -2.0])
    y = apply("twist", bends, {"twist_rad_per_kpa": 0.4}, conditions=pressure)
    turned = bends.reshape(3, 2, 2) @ [1, 1j] * np.exp(0.4j * pressure[:, None] * [0.25, 0.75])
    np.testing.assert_allclose(y.reshape(3, 2, 2) @ [1, 1j], turned)


@pytest.mark.parametrize("name", ["twist", "p others(p)", "p lag(drawn)"])
def test_what_needs_several_chambers_cannot_act_in_a_finger(name):
    geometry = Geometry("finger", 100.0, (25.0, 75.0))
    assert Pipeline(geometry, [name]).left_out == {name: "the device has one chamber"}
    assert not Pipeline(replace(geometry, device="arm"), [name]).left_out
