"""What is measured, and in which order it counts."""

import numpy as np
import pytest

from pneutac_sim.finger import quantities


def test_curvature_counts_before_joint_angles():
    columns = ["q_1_rad", "curvature_x_1_per_m", "q_2_rad", "curvature_y_1_per_m"]
    assert quantities.headline(columns, "arm") == (["curvature_x_1_per_m", "curvature_y_1_per_m"], "1/m")
    assert quantities.headline(["q_1_rad", "tip_z_mm"], "finger") == (["tip_z_mm"], "mm")
    assert quantities.headline(["pressure_kpa"], "finger") == ([], "")
    assert quantities.observations(columns, "finger") == ["q_1_rad", "q_2_rad"], "of an arm alone"


def test_rms_is_of_the_euclidean_distance():
    assert quantities.rms(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(5 / np.sqrt(2))
    assert np.isnan(quantities.rms(np.zeros((0, 2))))
