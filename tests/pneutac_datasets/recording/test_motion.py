import numpy as np

from pneutac_datasets.recording.motion import Motion


def test_points_on_a_line_are_not_turned_about_it():
    points = np.linspace(0, 30, 50)[:, None] * [1.0, 0.0, 0.5]
    noise = np.random.default_rng(0).normal(0, 0.05, points.shape)
    found = Motion.fit(points, points + [20.0, 0.0, 0.0] + noise, True)
    assert found.angle_deg < 1
    np.testing.assert_allclose(found(points), points + [20.0, 0.0, 0.0], atol=0.1)


def test_a_bend_the_other_way_is_a_turn_about_the_long_axis():
    bend = np.linspace(0.1, 1.2, 60)
    points = 100 * np.stack([np.sin(bend) / bend, 0 * bend, (1 - np.cos(bend)) / bend], 1)
    found = Motion.fit(points * [1.0, 1.0, -1.0], points, True)
    assert found.angle_deg > 170
    np.testing.assert_allclose(found(points * [1.0, 1.0, -1.0]), points, atol=1.0)
