"""`pneutac new` and `pneutac compare`: the result's contract, where it fails, bad input.

Prediction bands: right where the twin is, missed where an effect is missing, honest without intervals.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from generated import once, twin_of
from verbs import refused, verb

from lerobot_pneutac.verbs.compare_body import compare_body, phrase, prediction_band, train_mask
from lerobot_pneutac.verbs.fit_body import calibrate_body
from pneutac_datasets.generate.finger import generate
from pneutac_datasets.recording.axes import Axis, axes, motion
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import BodyData, fit, simulate
from pneutac_sim.surrogate.finger import builtin, fingerprint
from pneutac_sim.surrogate.network import MARGIN, ActionNetwork
from pneutac_sim.twin import Twin, Value

CONTRACT = ["pressure_cmd_kpa", "direction", "rate", "hold_time_s", "program", "trial", "gravity"]
CONTRACT += ["temperature_c", "payload_g"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory, no_soft_body):
    """A recording without and one with creep of the same finger, and a twin fitted to the first."""
    root = tmp_path_factory.mktemp("bench")
    for name in ("none", "creep"):
        once(generate, name, root / name, seed=16, minutes=2, hz=10)
    verb("new", twin=root / "twin", recording=root / "none")
    r = Recording.load(root / "none")
    found = calibrate_body(Twin.load(root / "twin"), r)
    found.twin.save_version(
        root / "twin", "calibrated", str(root / "none"), {**found.error, "unit": "mm", "seed": 0}
    )
    return root


def run(bench, recording, out):
    verb("compare", twin=bench / "twin", recording=bench / recording, out=out)
    return json.loads((out / "result.json").read_text())


@pytest.mark.slow
def test_a_right_twin_has_no_more_than_the_noise_everywhere(bench, tmp_path):
    result = run(bench, "none", tmp_path)
    truth = json.loads((bench / "truth" / "none.json").read_text())
    assert result["unit"] == "mm"
    assert result["noise_floor"] == pytest.approx(truth["noise_floor_mm"], rel=0.2)
    assert result["error"]["heldout"] == pytest.approx(truth["noise_floor_mm"], rel=0.1)
    assert "at the noise" in result["sentence"]
    assert [h["change"] for h in result["history"]] == ["calibrated"]
    assert result["history"][0]["heldout"] == pytest.approx(result["error"]["heldout"])
    assert result["pressure"]["error"]["heldout"] < 0.1


@pytest.mark.slow
def test_a_wrong_twin_shows_where_it_fails(bench, tmp_path, capsys):
    result = run(bench, "creep", tmp_path)
    assert set(CONTRACT) <= set(result["by"])
    assert result["error"]["heldout"] > 2 * result["noise_floor"]
    n, total = result["samples"], result["error"]["all"] ** 2 * result["samples"]
    for name in set(CONTRACT) - {"hold_time_s"}:  # every sample is in one bin, and the bins make up the whole
        rows = result["by"][name]
        assert sum(r["n"] for r in rows) == n, name
        assert sum(r["error"] ** 2 * r["n"] for r in rows) == pytest.approx(total), name
        assert sum(r["share"] for r in rows) == pytest.approx(1.0), name
    worst = result["worst"]
    assert len(worst) == 5 and [w["error"] for w in worst] == sorted(
        (w["error"] for w in worst), reverse=True
    )
    assert worst[0]["error"] > result["error"]["all"]
    for w in worst:
        assert set(w) >= {"trial", "from_s", "to_s", "error"} and 0 < w["to_s"] - w["from_s"] <= 2.0
    assert re.match(r"The twin misses the measured tip by [\d.]+ mm, .* times the noise", result["sentence"])
    assert "The twin misses" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_samples_beyond_the_training_of_the_action_network_are_told(bench, tmp_path):
    def with_network(at_most_kpa: float, mark: str) -> dict:
        twin = Twin.load(bench / "twin")
        network = ActionNetwork.load(builtin("action"))
        high, low = network.high.copy(), network.low.copy()
        high[:4], low[:4], high[-1], low[-1] = 9.0, -9.0, at_most_kpa, -9.0
        drive = np.array([twin.parameter("gain_rad_per_kpa"), twin.parameter("rest_pressure_kpa")])
        own = replace(network, fingerprint=mark, high=high, low=low, drive=drive)
        file = own.save(tmp_path / "action.safetensors")
        twin.networks = {"action": file}
        twin.save(tmp_path / "twin")
        verb("compare", twin=tmp_path / "twin", recording=bench / "none", out=tmp_path / "o")
        return json.loads((tmp_path / "o" / "result.json").read_text())

    assert run(bench, "none", tmp_path / "without")["out_of_range"] is None
    own = fingerprint(Twin.load(bench / "twin"))
    limit = 8.0
    result = with_network(limit, own)
    margin = MARGIN * (limit + 9.0)  # still counted as in range
    command = Recording.load(bench / "none").column("pressure_cmd_kpa")
    assert result["out_of_range"] == pytest.approx((command > limit + margin).mean(), abs=0.02)
    assert 0.05 < result["out_of_range"] < 0.95
    said = " ".join(result["checks"])
    assert "of samples lie outside what the twin's action network was trained with" in said
    assert "samples outside it" in (tmp_path / "o" / "report.html").read_text()
    result = with_network(1e3, own)
    assert result["out_of_range"] == 0 and "All samples lie within" in " ".join(result["checks"])
    result = with_network(1e3, "another")
    assert result["out_of_range"] is None
    assert f"run `pneutac surrogate --twin={tmp_path / 'twin'}`" in " ".join(result["checks"])


@pytest.mark.slow
def test_a_recording_that_the_twin_was_never_fitted_to_has_one_error(bench):
    twin = Twin.load(bench / "twin")
    other = compare_body(twin, Recording.load(bench / "creep"))
    assert other.train is None and other.heldout == other.error["all"]
    assert "error, all rows" in [r[""] for r in other.rows()]
    own = compare_body(twin, Recording.load(bench / "none"))
    assert own.train is not None and own.heldout != own.error["all"]


@pytest.mark.slow
def test_the_split_of_the_fit_is_used_again(bench):
    r = Recording.load(bench / "none")
    twin = Twin.load(bench / "twin")
    np.testing.assert_array_equal(train_mask(twin, r), r.split(0)[0])
    twin.history.append({"recording": str(bench / "none"), "seed": 5})
    expected = r.split(5)[0]
    np.testing.assert_array_equal(train_mask(twin, r), expected)
    assert not train_mask(twin, Recording.load(bench / "creep")).any(), "it was never fitted to that one"


@pytest.mark.slow
def test_direction_rate_and_hold_time_follow_the_command(bench):
    r = Recording.load(bench / "none")
    rate, held = motion(r)
    p, t = r.column("pressure_cmd_kpa"), r.column("time_s")
    slow = (r.column("program") == "triangle_slow") & (r.column("trial") == 0)
    inner = np.flatnonzero(slow)[10:-10]
    expected = np.gradient(p[inner], t[inner])
    assert np.median(np.abs(rate[inner] - expected)) < 1e-4 * np.abs(expected).max()
    assert held[slow].max() < 0.3
    hold = np.flatnonzero(r.column("program") == "long_hold")
    assert held[hold].max() == pytest.approx(11.0, abs=0.5)  # 55 s in a ten-minute session
    by = {a.name: a for a in axes(r)}
    way = np.asarray(by["direction"].labels)[by["direction"].bin[inner]]
    right = way == np.where(expected > 0, "loading", "unloading")
    assert right.mean() > 0.97  # all but the samples right after a turning point
    assert np.asarray(by["direction"].labels)[by["direction"].bin[hold[60]]] == "hold"


@pytest.mark.slow
def test_the_poorest_recording_still_compares(bench, tmp_path):
    r, rows = Recording.load(bench / "none"), 40
    r.keep(np.arange(len(r)) < 3).write(tmp_path / "three")
    refused(
        "has 3 usable samples, and .* at least 10",
        "compare",
        twin=bench / "twin",
        recording=tmp_path / "three",
    )
    r.keep(np.arange(len(r)) < rows).write(tmp_path / "poor")
    verb("compare", twin=bench / "twin", recording=tmp_path / "poor", out=tmp_path / "o")
    result = json.loads((tmp_path / "o" / "result.json").read_text())
    assert result["samples"] == rows and any("one trial only" in s for s in result["checks"])
    assert "worst at" not in result["sentence"] and "worst where" not in result["sentence"]


@pytest.mark.slow
def test_a_constant_command_and_too_few_rows_lead_the_headline(bench, tmp_path):
    r = Recording.load(bench / "creep")
    moving = np.flatnonzero(np.diff(r.column("pressure_cmd_kpa")))[0]
    r.samples["tip_z_mm"] += 20.0
    few = r.keep(np.isin(np.arange(len(r)), moving + np.arange(20))).write(tmp_path / "few")
    r.samples["pressure_cmd_kpa"] = 20.0
    for folder, start, end in (
        (r.write(tmp_path / "constant"), "The commanded pressure never moves", " mm."),
        (few, "The twin misses", "20 rows are too few to show where it is worst; record longer."),
    ):
        result = run(bench, folder, tmp_path / "out" / folder.name)
        assert result["sentence"].startswith(start) and result["sentence"].endswith(end)


def test_a_rate_is_told_in_words():
    axis = Axis("rate", None, np.arange(4), ["hold", "0.1 to 2 kPa/s", "2 to 7 kPa/s", "7 to 165 kPa/s"])
    said = [phrase(axis, i) for i in range(4)]
    assert said[0] == "while the pressure is held" and said[3] == "when the pressure moves fast"
    assert len(set(said)) == 4 and not any("kPa" in s for s in said)


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
    assert "95 % band, test" in (tmp_path / "out" / "report.html").read_text()
    row = next(r["value"] for r in good.rows() if r[""] == "inside the 95 % band")
    assert re.match(r"9\d % of the test values; about 95 % is expected", row)


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
