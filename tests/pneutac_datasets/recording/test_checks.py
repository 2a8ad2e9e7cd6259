"""Faults put into a clean recording are found, and a clean recording is left alone."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.noise import noise_floor, repeats
from pneutac_datasets.recording.recording import Recording

HZ = 50


def recording(seed=0, noise=0.1, trials=3, seconds=40, measured=True, **columns):
    """A finger whose bend follows steps and ramps of pressure within 50 ms."""
    rng = np.random.default_rng(seed)
    n = seconds * HZ
    t = np.arange(n) / HZ
    knots = np.repeat(rng.uniform(0, 50, seconds // 4), 4 * HZ)
    ramp = 25 * (1 - np.cos(2 * np.pi * t / 10))
    p = np.where(t < seconds / 2, knots, ramp)
    lag = np.convolve(np.r_[np.full(HZ, p[0]), p], np.exp(-np.arange(HZ) / 2.5) / 3.03, "full")[HZ : HZ + n]
    bend = 0.03 * lag
    frames = []
    for k in range(trials):
        frames.append(
            pd.DataFrame(
                {
                    "trial": k,
                    "program": "mixed",
                    "time_s": t,
                    "pressure_cmd_kpa": p,
                    **({"pressure_kpa": lag} if measured else {}),
                    "tip_x_mm": 100 * np.sinc(bend / np.pi) + noise * rng.normal(size=n),
                    "tip_z_mm": 50 * bend + noise * rng.normal(size=n),
                }
            )
        )
    samples = pd.concat(frames, ignore_index=True).assign(**columns)
    return Recording(Path("r"), {"device": "finger", "length_mm": 100.0}, samples, "finger")


def test_jumps_that_come_back_are_left_out_and_named():
    r = recording()
    bad = np.zeros(len(r), bool)
    for start, length in ((700, 1), (2600, 8), (4710, 20)):
        bad[start : start + length] = True
    r.samples.loc[bad, "tip_x_mm"] += 30.0
    clean, said = check(r)
    assert (
        len(said) == 1 and "jumps away and comes back 3 times" in said[0] and "trial 0 at 14.00 s" in said[0]
    )
    kept = set(zip(clean.column("trial"), clean.column("time_s"), strict=True))
    wrong = zip(r.column("trial")[bad], r.column("time_s")[bad], strict=True)
    assert kept.isdisjoint(wrong)
    assert len(r) - len(clean) < 2.5 * bad.sum()


def test_a_pressure_pulse_is_no_jump():
    r = recording()
    pulse = slice(700, 720)
    r.samples.loc[r.samples.index[pulse], "pressure_cmd_kpa"] += 30.0
    r.samples.loc[r.samples.index[pulse], "tip_x_mm"] -= 20.0
    clean, _ = check(r)
    assert len(clean) == len(r)


def test_a_shift_that_stays_is_reported_and_kept():
    r = recording()
    at = slice(1500, 2000)  # within a ramp, to the end of the first trial
    r.samples.loc[r.samples.index[at], "tip_z_mm"] += 15.0
    clean, said = check(r)
    assert any("shifts suddenly 1 time" in s for s in said) and len(clean) == len(r)


def test_a_tracker_that_stands_still_is_left_out():
    r = recording()
    at = r.samples.index[1200:1300]
    for c in ("tip_x_mm", "tip_z_mm"):
        r.samples.loc[at, c] = r.samples[c].iloc[1200]
    clean, said = check(r)
    assert any("stands still" in s for s in said)
    assert 95 <= len(r) - len(clean) <= 100


def test_saturation_and_gaps_are_named():
    r = recording()
    r.samples["pressure_kpa"] = np.minimum(r.samples["pressure_kpa"], 30.0)
    r.samples.loc[r.samples["time_s"] > 30, "time_s"] += 5.0
    _, said = check(r)
    assert any("'pressure_kpa' stays at 30 while" in s and "gauge saturates" in s for s in said)
    assert any("3 gaps" in s and "5.0 s" in s for s in said)


@pytest.mark.parametrize("noise", [0.05, 0.3])
@pytest.mark.parametrize("way", ["repeats", "holds"])
def test_noise_floor_recovers_the_injected_noise(noise, way):
    r = recording(noise=noise, trials=3 if way == "repeats" else 1, seed=4)
    floor = noise_floor(r)
    assert bool(repeats(r)) == (way == "repeats")
    assert ("equal runs" in floor.how) == (way == "repeats")
    assert floor.value == pytest.approx(noise * np.sqrt(2), rel=0.2)
    assert floor.unit == "mm" and set(floor.by_column) == {"tip_x_mm", "tip_z_mm"}


def test_slow_drift_between_repeats_counts_for_the_session_only():
    r = recording(noise=0.1)
    r.samples["tip_z_mm"] += 2.0 * r.samples["trial"]
    floor = noise_floor(r)
    assert floor.value == pytest.approx(0.1 * np.sqrt(2), rel=0.2)
    assert floor.session > 1.0


def test_runs_under_unequal_conditions_are_no_repeats():
    r = recording(trials=2)
    assert len(repeats(r)) == 1
    r.samples["temperature_c"] = 21.0 + 5.0 * r.samples["trial"]
    assert repeats(r) == []


def test_stated_noise_is_used_where_nothing_repeats():
    r = recording(trials=1)
    r.meta["noise"] = {"tip_x_mm": 0.3, "tip_z_mm": 0.4}
    assert noise_floor(r).value == pytest.approx(0.5)
    assert "stated" in noise_floor(r).how


def test_real_tracker_jumps_are_found_and_left_out():
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA does not name a folder with real recordings")
    r = Recording.load(Path(os.environ["PNEUTAC_DATA"]) / "soft" / "three_bellow_arm")
    clean, said = check(r)
    assert any("tracker jumps" in s and "1.40 s" in s for s in said)
    assert 20 <= len(r) - len(clean) < 250
    size = np.abs(np.diff(clean.column("curvature_y_1_per_m")))
    assert size.max() < 1.0 < np.abs(np.diff(r.column("curvature_y_1_per_m"))).max()
