import numpy as np

from lerobot_pneutac.study.body_model import rate


def test_the_rate_of_the_drive_stops_at_a_trial():
    u = np.array([0.0, 1.0, 2.0, 10.0, 10.0])[:, None]
    dt = np.array([np.inf, 0.5, 0.5, np.inf, 0.5])
    np.testing.assert_allclose(rate(u, dt)[:, 0], [1.0, 2.0, 1.0, 0.0, 0.0])
