"""Prediction bands: right where the twin is, missed where an effect is missing, honest without intervals."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from generated import once, twin_of

from lerobot_pneutac.verbs.compare_band import prediction_band
from lerobot_pneutac.verbs.compare_body import compare_body
from lerobot_pneutac.verbs.fit_body import calibrate_body
from pneutac_datasets.generate.finger import generate
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import BodyData, fit, simulate
from pneutac_sim.twin import Twin, Value

COLUMNS = ("tip_x_mm", "tip_y_mm", "tip_z_mm")


@pytest.mark.nightly
def test_the_band_holds_the_truth_and_not_a_missing_effect(tmp_path):
    right, wrong = (
        once(generate, name, tmp_path / name, seed=3, minutes=2, hz=20) for name in ("none", "creep")
    )
    twin = calibrate_body(twin_of(right), right).twin
    good, bad = compare_body(twin, right), compare_body(twin, wrong)
    assert 0.91 < good.coverage < 0.98
    assert bad.coverage < 0.6
    refitted = compare_body(calibrate_body(twin_of(wrong), wrong).twin, wrong)
    assert refitted.coverage < 0.7  # the best fit without creep does not help itself with a wide band
    good.report(tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["coverage"] == pytest.approx(good.coverage)
    assert result["band"] == {"level": 0.95, "how": "the intervals of the twin's parameters and the noise"}
    assert "95 % band, held out" in (tmp_path / "out" / "report.html").read_text()
    row = next(r["value"] for r in good.rows() if r[""] == "inside the 95 % band")
    assert re.match(r"9\d % of the held-out values; about 95 % is expected", row)


def _short(twin: Twin, seed: int, sigma: float) -> Recording:
    """Twelve seconds of stairs of a twin, with white noise of `sigma` mm."""
    t = np.arange(120) / 10
    samples = pd.DataFrame({"trial": 0, "time_s": t, "pressure_cmd_kpa": 5.0 * (t // 1)})
    for c in COLUMNS:
        samples[c] = 0.0
    recording = Recording(
        "short", {"device": "finger", "length_mm": 110.0, "samples": "samples.csv"}, samples, "finger"
    )
    model = simulate(twin, BodyData.of(recording, twin)).model
    samples[list(COLUMNS)] = model + np.random.default_rng(seed).normal(0, sigma, model.shape)
    return recording


def test_the_band_of_the_parameters_is_the_scatter_of_fits_to_other_noise():
    """Beyond the pressures of the fit too, where it must widen."""
    truth, train = Twin.builtin(), np.arange(120) < 60  # up to half of the pressure
    silent = NoiseFloor(0.0, None, "mm", "", dict.fromkeys(COLUMNS, 0.0))
    models, halves = [], []
    for seed in range(16):
        data = BodyData.of(_short(truth, seed, 0.5), truth)
        twin = fit(truth, data, train=train, only=["gain_rad_per_kpa", "rest_pressure_kpa"], starts=1).twin
        models.append(simulate(twin, data).model)
        halves.append(prediction_band(twin, data, train, silent).half)
    scatter, told = np.std(models, axis=0), np.sqrt(np.mean(np.square(halves), axis=0)) / 1.96
    for part in (slice(0, 60), slice(90, 120)):
        assert 0.7 < np.sqrt((told[part] ** 2).sum() / (scatter[part] ** 2).sum()) < 1.4
    assert (told[90:] ** 2).mean() > 2 * (told[:60] ** 2).mean()


def test_without_intervals_the_band_is_the_noise_and_says_so():
    twin = Twin.builtin()
    data, train = BodyData.of(_short(twin, 0, 0.5), twin), np.arange(120) < 60
    noise = NoiseFloor(0.9, None, "mm", "", dict(zip(COLUMNS, (0.5, 0.4, 0.6), strict=True)))
    band = prediction_band(twin, data, train, noise)
    assert band.half == pytest.approx(np.tile(1.96 * np.array([0.5, 0.4, 0.6]), (120, 1)), rel=1e-3)
    assert "the noise alone" in band.how
    twin.parameters["gain_rad_per_kpa"] = Value(0.01114, (0.011, 0.01128))
    wider = prediction_band(twin, data, train, noise)
    assert (wider.half >= band.half).all() and wider.half[-1, 0] > 1.5 * band.half[-1, 0]
    silent = NoiseFloor(0.0, None, "mm", "", dict.fromkeys(COLUMNS, 0.0))
    assert prediction_band(Twin.builtin(), data, train, silent) is None
