import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pneutac_sim.errors import InputError
from pneutac_sim.finger.kinematics import (
    forward_kinematics,
    forward_kinematics_spatial,
    gain_profile,
    joint_command,
)

JOINTS = np.array([13.75, 41.25, 68.75, 96.25])


@pytest.mark.parametrize("n", [1, 4, 6])
def test_profile_has_unit_mean_and_the_papers_ratios(n):
    r = gain_profile(n, 0.0313, 0.2974)
    assert r.mean() == pytest.approx(1, abs=1e-14)
    m = np.arange(1, n + 1) - (n + 1) / 2
    ratio = np.exp(0.0313 * m) * (1 + 0.2974 * m**2)
    np.testing.assert_allclose(r / r[0], ratio / ratio[0], rtol=1e-13)


def test_profile_refuses_joints_that_bend_backwards():
    with pytest.raises(InputError, match="gain_beta"):
        gain_profile(4, 0.0, -0.6)


def test_command_is_linear_in_pressure_and_zero_at_minus_rest_pressure():
    q = joint_command(np.array([-10.7, 0.0, 5.0, 10.0]), 0.01114, 0.03, 0.3, 10.7, 4)
    np.testing.assert_allclose(q[0], 0, atol=1e-15)
    np.testing.assert_allclose(q[3] - q[2], q[2] - q[1])
    np.testing.assert_allclose(q[1].sum(), 4 * 0.01114 * 10.7)


def test_straight_finger_ends_at_its_length():
    tip, bend = forward_kinematics(np.zeros((3, 4)), JOINTS, 110.0)
    np.testing.assert_allclose(tip, [[110, 0]] * 3)
    np.testing.assert_allclose(bend, 0)


def test_spatial_bend_in_either_plane_equals_the_planar_finger():
    q = np.array([0.3, -0.1, 0.2, 0.4])
    planar, bend = forward_kinematics(q, JOINTS, 110.0)
    to_z, bend_z = forward_kinematics_spatial(np.stack([q, 0 * q], -1), JOINTS, 110.0)
    to_y, bend_y = forward_kinematics_spatial(np.stack([0 * q, q], -1), JOINTS, 110.0)
    np.testing.assert_allclose(to_z, [planar[0], 0, planar[1]], atol=1e-12)
    np.testing.assert_allclose(to_y, [planar[0], planar[1], 0], atol=1e-12)
    np.testing.assert_allclose(bend_z, [bend, 0])
    np.testing.assert_allclose(bend_y, [0, bend])


def test_spatial_tip_equals_the_product_of_rotations():
    rng = np.random.default_rng(1)
    q = rng.normal(scale=0.5, size=(20, 6, 2))
    q[0] = 0.0
    s_n = np.linspace(10, 100, 6)
    tip, _ = forward_kinematics_spatial(q, s_n, 110.0)
    links = np.diff(np.append(s_n, 110.0))
    for angles, found in zip(q, tip, strict=True):
        frame, end = Rotation.identity(), np.array([10.0, 0, 0])
        for (to_z, to_y), link in zip(angles, links, strict=True):
            frame = frame * Rotation.from_rotvec([0, -to_z, to_y])
            end = end + link * frame.apply([1, 0, 0])
        np.testing.assert_allclose(found, end, atol=1e-10)


def test_joints_out_of_order_are_refused():
    with pytest.raises(InputError, match="rise from base to tip"):
        forward_kinematics(np.zeros(2), np.array([50.0, 20.0]), 110.0)
