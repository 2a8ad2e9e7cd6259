"""Out-of-time validation: rows of a condition that never occurred before stay in the fit."""

import numpy as np
import pandas as pd

from lerobot_pneutac.diagnosis.parts import conditions, out_of_time
from pneutac_datasets.recording.recording import Recording


def test_later_rows_are_left_out_only_where_their_condition_occurred_before(tmp_path):
    n = 100
    table = pd.DataFrame(
        {"trial": 0, "time_s": np.arange(n) / 10, "pressure_cmd_kpa": 0.0, "bend_angle_rad": 0.0}
    )
    over = np.where(np.arange(n) >= 80, 1.0, -1.0)
    table = table.assign(gravity_x=0.0, gravity_y=0.0, gravity_z=over, payload_g=0.0)
    recording = Recording(tmp_path, {"device": "finger", "length_mm": 100.0}, table, "finger")
    condition = conditions(recording)
    assert len(np.unique(condition)) == 2
    fold = out_of_time(condition, 50)
    assert (fold[:50] == -1).all() and (fold[50:80] == 0).all() and (fold[80:] == -1).all()
    assert (out_of_time(condition, 90)[90:] == 0).all()
    assert (out_of_time(np.zeros(n, int), 50)[50:] == 0).all(), (
        "one condition alone: all later rows are predicted"
    )
