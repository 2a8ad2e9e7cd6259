"""Pressures in bar or psi under a name that says kPa."""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.study.pair import pressure_unit_doubts, unlike_the_twin
from lerobot_pneutac.verbs.calibrate import calibrate
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin, Value


@pytest.mark.parametrize(
    ("rad_per_kpa", "unit"),
    [(0.0446, None), (0.0446 * 6.895, "psi"), (4.46, "bar"), (0.02, None), (0.11, None), (2.0, "bar")],
)
@pytest.mark.parametrize("joints", [2, 6])
def test_the_bend_for_its_material_tells_the_unit(rad_per_kpa, unit, joints):
    """Of 110 mm: the paper's finger bends by 0.0446 rad a kPa, rods that reach 90 or 15 kPa less or more."""
    twin = Twin("finger", 110.0, [110 * (i + 0.5) / joints for i in range(joints)])
    twin.parameters["gain_rad_per_kpa"] = Value(-rad_per_kpa / joints)
    found = pressure_unit_doubts(twin)
    assert (f"in {unit}?" in found[0]) if unit else not found
    twin.parameters["youngs_modulus_mpa"] = Value(0.01)  # of one so soft it is what it has to be
    assert unit == "bar" or not pressure_unit_doubts(twin)


def test_a_bench_in_bar_is_asked_about_when_it_is_calibrated():
    t = np.arange(400) / 10
    bar = np.repeat(np.random.default_rng(0).uniform(0, 0.6, 20), 20)
    samples = pd.DataFrame({"trial": 0, "time_s": t, "pressure_cmd_kpa": bar, "bend_angle_rad": 1.5 * bar})
    recording = Recording("bench", {"device": "finger", "length_mm": 80.0}, samples, "finger")
    result = calibrate(new_twin(recording=recording), recording)
    assert any(
        "are the pressures in bar? Then multiply the pressure columns by 100" in f for f in result.findings
    )


@pytest.mark.parametrize(("kpa", "unit"), [(1.0, None), (6.895, "psi"), (100.0, "bar")])
def test_a_recording_in_another_unit_than_that_of_its_calibrated_twin_is_asked_about(kpa, unit):
    """Of 110 mm and four joints, 0.0446 rad a kPa; the tip moves as on an arc that bends by 1 rad."""
    twin = Twin("finger", 110.0, [13.75, 41.25, 68.75, 96.25])
    twin.parameters["gain_rad_per_kpa"] = Value(0.0446 / 4, (0.011, 0.0113))
    bend = np.linspace(0.01, 1.0, 50)
    samples = pd.DataFrame(
        {
            "trial": 0,
            "time_s": np.arange(50) / 10,
            "pressure_cmd_kpa": bend / 0.0446 / kpa,
            "tip_x_mm": 110 * np.sin(bend) / bend,
            "tip_z_mm": 110 * (1 - np.cos(bend)) / bend,
        }
    )
    found = unlike_the_twin(twin, Recording("bench", {"device": "finger"}, samples, "finger"))
    assert (f"are the pressures in {unit}?" in found[0]) if unit else not found
