"""A finger of constant curvature whose bend is a curve of the pressure: no stretch, no tilt, no swing."""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac import calibrate, diagnose
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.recording.recording import Recording

LENGTH_MM, TOP_KPA, LAG_S = 100.0, 60.0, 0.15


def recording(curve, hz: float, lag_s: float = 0.0, seed: int = 0) -> Recording:
    """Three runs of held random steps and one of a slow wave, each command sent at its row; noise 0.2 mm."""
    rng, rows = np.random.default_rng(seed), []
    for run in range(4):
        t = np.arange(0, 40, 1 / hz)
        hold = 2.0 + run % 2
        levels = rng.uniform(0, TOP_KPA, 21)
        levels[[0, 10]] = 0.0, TOP_KPA
        u = levels[(t // hold).astype(int)] if run < 3 else TOP_KPA * (0.5 - 0.5 * np.cos(2 * np.pi * t / 8))
        p = u.copy()
        for i in range(1, len(u) if lag_s else 0):  # exact for a command that is held from row to row
            p[i] = u[i - 1] + (p[i - 1] - u[i - 1]) * np.exp(-1 / hz / lag_s)
        bend = 1.0 * curve(p) / curve(TOP_KPA) + 1e-9
        table = {"trial": run, "time_s": t, "pressure_cmd_kpa": u}
        if lag_s:
            table["pressure_kpa"] = p + rng.normal(0, 0.1, len(t))
        table["tip_x_mm"] = LENGTH_MM * np.sin(bend) / bend + rng.normal(0, 0.2, len(t))
        table["tip_z_mm"] = LENGTH_MM * (1 - np.cos(bend)) / bend + rng.normal(0, 0.2, len(t))
        rows.append(pd.DataFrame(table))
    meta = {"device": "finger", "length_mm": LENGTH_MM}
    return Recording("bench", meta, pd.concat(rows, ignore_index=True), "finger")


def saturating(p):
    return np.tanh(p / 50)


@pytest.mark.slow
@pytest.mark.parametrize(
    "curve",
    [
        saturating,
        pytest.param(lambda p: np.expm1(p / 40), marks=pytest.mark.nightly),
        pytest.param(lambda p: np.log1p(p / 30), marks=pytest.mark.nightly),
    ],
)
def test_a_curve_of_the_pressure_is_no_stretch_and_no_tilted_base(curve):
    given = recording(curve, 10.0)
    result = calibrate(new_twin(recording=given), given)
    assert not result.twin.effects
    assert sum("with a curve of the pressure" in f for f in result.findings) == 2


@pytest.mark.slow
def test_a_proportional_bend_has_no_curve():
    given = recording(lambda p: p, 10.0)
    result = calibrate(new_twin(recording=given), given)
    assert not result.twin.effects and not any("left out" in f for f in result.findings)


@pytest.mark.nightly  # every day: README, and test_measured_pressure_tells_the_valve_from_the_body
@pytest.mark.slow
def test_a_slow_valve_before_a_saturating_bend_is_found_with_its_constants():
    given = recording(saturating, 20.0, LAG_S)
    found = diagnose(calibrate(new_twin(recording=given), given).twin, given)
    effects = found.twin.effects
    assert set(effects) == {"valve_lag", "gain_saturation"}
    assert [v.value for v in effects["valve_lag"].values()] == pytest.approx([LAG_S, LAG_S], rel=0.05)
    assert effects["gain_saturation"]["saturation_pressure_kpa"].value == pytest.approx(50, rel=0.05)
