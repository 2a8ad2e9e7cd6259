"""The noise floor, and the checks, on ordinary logs: of any rate and hold, with nothing hidden in them."""

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pneutac_benchmarks.diagnosis.cases import Case
from pneutac_benchmarks.diagnosis.logs import made
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.noise import noise_floor, repeats
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError


def stepped(hz=20, hold_s=2.0, rows=1200, trials=1, noise=0.01, seed=0):
    """A finger whose bend follows steps of pressure at once, with white noise."""
    rng, k = np.random.default_rng(seed), rows // trials
    p = np.repeat(rng.uniform(0, 15, rows), int(hold_s * hz))[:rows].round(3)
    return recording(p, 0.04 * (p + 3) + rng.normal(0, noise, rows), hz, np.repeat(np.arange(trials), k))


def recording(p, bend, hz, trial=0, **more):
    n = len(p)
    trial = np.broadcast_to(trial, n)
    t = (np.arange(n) - np.searchsorted(trial, trial)) / hz
    s = pd.DataFrame({"trial": trial, "time_s": t, "pressure_cmd_kpa": p, "bend_angle_rad": bend, **more})
    return Recording(Path("log"), {"device": "finger", "length_mm": 100.0}, s, "finger")


def repeated(noise=0.01, runs=3):
    """The same program several times."""
    p = np.tile(stepped(rows=800).column("pressure_cmd_kpa"), runs)
    bend = 0.04 * (p + 3) + np.random.default_rng(4).normal(0, noise, len(p))
    return recording(p, bend, 20, np.repeat(np.arange(runs), 800))


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_equal_runs_measure_the_noise_and_a_drift_between_them_counts_for_the_session_only(noise):
    r = repeated(noise)
    floor = noise_floor(r)
    assert len(repeats(r)) == 3 and "equal runs" in floor.how and floor.known and floor.unit == "rad"
    assert floor.value == pytest.approx(noise, rel=0.1) and floor.session < 1.2 * noise
    r.samples["bend_angle_rad"] += 10 * noise * r.samples["trial"]
    floor = noise_floor(r)
    assert floor.value == pytest.approx(noise, rel=0.1) and floor.session > 5 * noise
    r.samples["temperature_c"] = 21.0 + 5.0 * r.samples["trial"]
    assert repeats(r) == []  # under unequal conditions


def test_stated_noise_is_used_where_nothing_repeats():
    r = stepped()
    r.samples = r.samples.rename(columns={"bend_angle_rad": "tip_x_mm"}).assign(tip_z_mm=0.0)
    r.meta["noise"] = {"tip_x_mm": 0.3, "tip_z_mm": 0.4}
    assert noise_floor(r).value == pytest.approx(0.5) and "stated" in noise_floor(r).how


@pytest.mark.parametrize(("hz", "hold_s"), [(10, 1.5), (5, 2.0), (4, 0.5), (100, 0.5)])
def test_the_noise_of_a_log_of_short_holds_is_within_a_tenth(hz, hold_s):
    floor = noise_floor(stepped(hz, hold_s))
    assert floor.value == pytest.approx(0.01, rel=0.1) and not floor.known
    assert floor.by_column == {"bend_angle_rad": floor.value}


@pytest.mark.parametrize("effect", ["plain", "creep", "hysteresis", "valve"])
def test_the_noise_of_drawn_logs_is_within_a_fifth(effect):
    for seed in range(8):
        log, r, noise = made(Case("logs", "plain" if effect == "plain" else "effect", effect, seed))
        if effect == "valve" and log.hold_s < 2:
            continue  # a valve that is slower than the holds hides the noise
        r.meta.pop("noise", None)
        assert noise_floor(r).value == pytest.approx(noise, rel=0.2), seed


def test_noise_that_is_correlated_from_row_to_row_is_seen_in_quiet_rows():
    r, rng = stepped(hz=50, hold_s=4.0, rows=6000, noise=0.0), np.random.default_rng(0)
    filtered = np.convolve(rng.normal(0, 1, 6002), np.ones(3) / 3**0.5, "valid")
    r.samples["bend_angle_rad"] += 0.01 * filtered
    assert noise_floor(r).value == pytest.approx(0.01, rel=0.15)


def test_a_short_repeat_is_no_measurement_of_the_noise():
    r = repeated(runs=2).keep(np.arange(1600) < 900)
    floor = noise_floor(r)
    assert sum(len(a) for a, *_ in repeats(r)) == 100 and not floor.known
    assert floor.value == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("drift", [0.0, 0.1])
@pytest.mark.parametrize("uneven", [0.02, 0.1])
def test_one_program_driven_by_an_uneven_timer_measures_the_noise(uneven, drift):
    rng, hz, rows = np.random.default_rng(6), 10, 900
    stair = np.resize([0, 3, 6, 9, 12, 9, 6, 3], rows)
    runs = []
    for run in range(3):
        t = np.cumsum(rng.normal(1, uneven, rows)) / hz
        p = stair[(t / 2.5).astype(int)].astype(float)  # steps every 2.5 s by the clock
        x = np.zeros(rows)
        for i in range(1, rows):
            x[i] = p[i - 1] + (x[i - 1] - p[i - 1]) * np.exp(-(t[i] - t[i - 1]) / 0.2)
        gain = 0.05 * (1 - drift * np.exp(-(run * 100 + t) / 60))
        runs.append(
            pd.DataFrame({"trial": run, "time_s": t, "pressure_cmd_kpa": p, "bend_angle_rad": gain * x})
        )
    samples = pd.concat(runs, ignore_index=True)
    samples["bend_angle_rad"] += rng.normal(0, 0.004, len(samples))
    floor = noise_floor(Recording(Path("log"), {"device": "finger", "length_mm": 100.0}, samples, "finger"))
    assert floor.known and floor.value == pytest.approx(0.004, rel=0.1) and "3 pairs" in floor.how


def test_jumps_of_the_marker_are_no_noise():
    r = stepped(rows=1200)
    r.samples.loc[r.samples.index[100::150], "bend_angle_rad"] += 0.5
    assert noise_floor(r).value == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("repeated", [False, True])
def test_a_regulator_that_hunts_under_pressure_is_no_noise_of_the_sensor(repeated):
    r, rng = stepped(rows=2400, trials=2), np.random.default_rng(1)
    p = np.where(np.arange(1200) // 40 % 3 == 0, 0.0, r.samples["pressure_cmd_kpa"][:1200])
    p = np.r_[p, p if repeated else np.roll(p, 200)]
    swing = 0.1 * np.sin(2 * np.pi * 2.3 * np.arange(2400) / 20 + rng.normal(0, 0.3, 2400).cumsum())
    bend = 0.04 * (p + 3) + rng.normal(0, 0.01, 2400) + np.where(p > 0.5, swing, 0.0)
    floor = noise_floor(recording(p, bend, 20, np.repeat([0, 1], 1200)))
    assert floor.value == pytest.approx(0.01, rel=0.1) and floor.known is repeated
    assert "rows at rest" in floor.how and "times as much" in floor.how


def test_where_the_noise_cannot_be_determined_it_is_unknown_and_says_what_to_record():
    short = noise_floor(stepped(rows=100))
    assert short.value is None and short.floor == 0.0 and not short.known and short.by_column == {}
    assert "cannot be determined" in short.how and "record two minutes" in short.how
    with pytest.raises(InputError, match="log: the noise cannot be determined"):
        short.needed("log")
    computed = noise_floor(recording(p := np.linspace(0, 10, 600), 0.02 * p, 20))
    assert computed.value is None and "'bend_angle_rad' repeats to the last digit" in computed.how


def test_long_recordings_are_sampled_in_pieces():
    assert noise_floor(stepped(hz=20, rows=60_000, seed=2)).value == pytest.approx(0.01, rel=0.05)


# ---------------------------------------------------------------- nothing is found where nothing is


@pytest.mark.parametrize("hz", [4, 7, 20])
def test_a_step_of_a_slow_log_is_no_shift_of_the_marker(hz):
    said = check(r := stepped(hz, 2.0, rows=300, noise=0.002))[1]
    assert len(said) == 1 and "no measured pressure" in said[0] and len(check(r)[0]) == len(r)


@pytest.mark.parametrize("hz", [5, 20])
@pytest.mark.parametrize("rows", [1, 3])
def test_a_commanded_pulse_is_no_jump_of_the_tracker(hz, rows):
    rng, p = np.random.default_rng(0), np.zeros(600)
    for i in range(30, 600, 60):
        p[i : i + rows] = rng.uniform(8, 15)
    r = recording(p, 0.04 * (p + 3) + rng.normal(0, 0.004, 600), hz)
    assert len(check(r)[0]) == len(r)


def test_a_pulse_that_steps_back_beyond_where_it_began_is_no_jump_of_the_tracker():
    rng, p = np.random.default_rng(0), np.full(600, 6.8)
    for i in range(30, 600, 120):
        p[i : i + 3], p[i + 3 : i + 30] = 2.2, 8.4
    r = recording(p, 0.07 * (p + 1) + rng.normal(0, 0.011, 600), 4)
    assert len(check(r)[0]) == len(r)


def test_an_outlier_at_a_step_is_still_left_out():
    r = stepped(hz=10, hold_s=3.0, rows=600, noise=0.004)
    r.samples.loc[r.samples.index[300], "bend_angle_rad"] += 1.0
    clean, said = check(r)
    assert 0 < len(r) - len(clean) < 5 and any("jumps away and comes back 1 time" in s for s in said)


def pushes(hz, rng, n=2400):
    """A person's quick pushes of a lever, with pauses, and the bend behind a valve that swings a little."""
    p, at, level = np.zeros(n), 10, 0.0
    while at < n:
        goal, rows = rng.uniform(0, 15), int(0.6 * hz)
        p[at : at + rows] = (level + (goal - level) * (1 - np.cos(np.linspace(0, np.pi, rows))) / 2)[: n - at]
        p[at + rows :], level = goal, goal
        at += rows + int(rng.uniform(0.5, 7) * hz)
    bend, x, speed = np.zeros(n), 0.0, 0.0
    for i in range(1, n):
        for _ in range(20):
            speed += (18.0**2 * (p[i - 1] - x) - 22.0 * speed) / hz / 20
            x += speed / hz / 20
        bend[i] = 0.06 * x + 0.05 * np.tanh(x / 8)
    return p, bend + rng.normal(0, 0.002, n)


@pytest.mark.parametrize("hz", [8, 10, 15])
def test_a_persons_quick_push_is_no_shift_of_the_marker_and_a_slip_is(hz):
    for seed in range(8):
        p, bend = pushes(hz, np.random.default_rng(seed))
        assert not any("suddenly" in s or "jumps" in s for s in check(recording(p, bend, hz))[1]), seed
        moves = np.r_[200, 200 + np.flatnonzero(np.diff(p[200:]))]
        longest = np.argmax(np.diff(moves))
        slipped = np.arange(2400) > moves[longest : longest + 2].mean()
        assert any("suddenly 1 time" in s for s in check(recording(p, bend + 0.2 * slipped, hz))[1]), seed


def test_an_outlier_on_a_ramp_is_one_row_and_no_shift():
    p = np.interp(np.arange(2400), [0, 50, 800, 900, 1500, 2399], [0, 0, 14, 14, 2, 12])
    for seed in range(5):
        rng = np.random.default_rng(seed)
        bad = np.sort(rng.choice(np.arange(100, 2300, 10), 6, replace=False))
        bend = 0.06 * p + rng.normal(0, 0.003, 2400)
        bend[bad] += rng.choice([-1, 1], 6) * rng.uniform(0.1, 0.4, 6)
        r = recording(p, bend, 20)
        clean, said = check(r)
        assert any("comes back 6 times" in s and "6 rows are left out" in s for s in said), said
        assert not any("suddenly" in s for s in said) and len(r) - len(clean) == 6


@pytest.mark.parametrize("tips", [False, True])
def test_an_open_loop_cosine_with_all_digits_is_no_feedback(tips):
    t = np.arange(1200) / 20
    for seed in range(10):
        rng = np.random.default_rng(seed)
        p = rng.uniform(5, 15) * (1 - np.cos(2 * np.pi * t / rng.uniform(3, 12)))
        r = recording(p, 0.02 * p + rng.normal(0, 0.002, 1200), 20)
        if tips:
            b = np.maximum(r.samples.pop("bend_angle_rad"), 1e-6)
            r.samples["tip_x_mm"] = 100 * np.sin(b) / b + rng.normal(0, 0.1, 1200)
            r.samples["tip_z_mm"] = 100 * (1 - np.cos(b)) / b + rng.normal(0, 0.1, 1200)
        assert not any("follows the measured motion" in s for s in check(r)[1]), seed


@pytest.mark.parametrize("trials", [1, 2])
def test_a_ramp_without_any_noise_has_no_finding_and_no_warning(trials):
    p = np.tile(np.linspace(0, 20, 600 // trials), trials)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        said = check(recording(p, 0.02 * p, 20, np.repeat(np.arange(trials), 600 // trials)))[1]
    assert len(said) == 1 and "no measured pressure" in said[0]
