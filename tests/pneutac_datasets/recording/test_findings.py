"""Each fault that is put into a generated recording is found, alone, and distinguished from physics."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from generated import once

from pneutac_datasets.generate.finger import generate
from pneutac_datasets.recording.checks import check, findings
from pneutac_datasets.recording.recording import Recording

KINDS = """
wrapped_angle jumps shift frozen stale_pose saturated clipped_command
quantised repeated other_unit gauge_scale gauge_stuck gauge_alone gauge_late
pressure_offset supply_limit gaps missing_rows closed_loop late_command exchanged_axes
misplaced_tip other_way_round drift no_measured_pressure unmoved exchanged_pressures
""".split()

TIP = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]


def copy(r):
    return Recording(r.folder, r.meta, r.samples.copy(), r.device, list(r.warnings))


def by_trial(r, column, change):
    """Changes a column (n,) trial by trial."""
    r = copy(r)
    x = r.column(column).astype(float)
    for rows in r.trials().values():
        x[rows] = change(x[rows])
    r.samples[column] = x
    return r


def only(r):
    """The one finding of a recording, whose sentence is short."""
    (f,) = findings(r)
    assert f.kind in KINDS and 40 < len(f.sentence) <= 400 and f.sentence.endswith(".")
    assert f.sentence in check(r)[1]
    return f


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    """Makes a generated recording of a hidden effect."""

    def make(effect):
        folder = tmp_path_factory.mktemp("checks") / effect
        once(generate, effect, folder, seed=4, minutes=5)
        return Recording.load(folder)

    return make


@pytest.fixture(scope="module")
def clean(generated):
    return generated("none")


@pytest.fixture
def r(clean):
    return copy(clean)


@pytest.mark.parametrize("effect", ["none", "creep", "valve_lag", "dead_time", "hysteresis", "leak"])
def test_physics_is_no_fault(generated, effect):
    r = generated(effect)
    assert findings(r) == [] and len(check(r)[0]) == len(r)


PUBLIC = {
    "asu_segment": {"jumps", "stale_pose", "quantised", "repeated"},  # a gauge of 12 bits, read now and then
    "sopra_segment": {"stale_pose", "no_measured_pressure"},  # 80 frames in 100 rows
    "three_bellow_arm": {"jumps", "no_measured_pressure"},
}


@pytest.mark.parametrize("name", PUBLIC)
def test_what_is_found_in_public_recordings_is_true(name):
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA does not name a folder with real recordings")
    r = Recording.load(Path(os.environ["PNEUTAC_DATA"]) / "soft" / name)
    train, heldout = r.split()
    assert 0.15 < heldout.mean() < 0.45 and (train ^ heldout).all()
    found = {f.kind: f for f in findings(r)}
    assert set(found) == PUBLIC[name] and set(found) <= set(KINDS)
    assert all(len(f.sentence) <= 400 for f in found.values())
    if name == "asu_segment":
        assert found["quantised"].numbers["step"] == pytest.approx(0.644, abs=0.001)
        assert 3 < found["repeated"].numbers["rows_each"] < 5
    if name == "sopra_segment":
        assert found["stale_pose"].numbers["share"] == pytest.approx(0.2, abs=0.01)
    if name == "three_bellow_arm":
        kept, curvature = check(r)[0], "curvature_y_1_per_m"
        assert "1.40 s" in found["jumps"].sentence and 20 <= len(r) - len(kept) < 250
        assert (
            np.abs(np.diff(kept.column(curvature))).max() < 1.0 < np.abs(np.diff(r.column(curvature))).max()
        )


def test_jumps_that_come_back_are_left_out_and_named(clean, r):
    bad = np.zeros(len(clean), bool)
    for start, length in ((2400, 1), (2500, 8), (2600, 20)):
        bad[start : start + length] = True
    r.samples.loc[bad, "tip_x_mm"] += 30.0
    f = only(r)
    assert f.kind == "jumps" and "comes back 3 times (first in trial 0 at 120.00 s)" in f.sentence
    assert set(np.flatnonzero(bad)) <= set(f.rows) and len(f.rows) < 2.5 * bad.sum()
    assert len(check(r)[0]) == len(r) - len(f.rows)


def test_a_shift_that_stays_is_reported_and_kept(r):
    r.samples.loc[1500 : r.trials()[0].stop - 1, "tip_z_mm"] += 15.0
    f = only(r)
    assert f.kind == "shift" and "shifts suddenly 1 time" in f.sentence and len(check(r)[0]) == len(r)


def test_a_tracker_that_stands_still_is_left_out(r):
    moves = r.samples.index[r.samples["program"] == "triangle_slow"][50:150]
    r.samples.loc[moves, TIP] = r.samples.loc[moves[0], TIP].to_numpy(float)
    f = only(r)
    assert f.kind == "frozen" and "stands still while the pressure moves" in f.sentence
    assert list(f.rows) == list(moves[1:]) and len(check(r)[0]) == len(r) - 99


def test_a_tracker_at_rest_until_a_late_finger_answers_a_step_stands_still_rightly(r):
    step = int(np.argmax(np.abs(np.diff(r.column("pressure_cmd_kpa"))))) + 1
    rests = r.samples.index[step - 20 : step + 6]
    assert np.ptp(r.column("pressure_cmd_kpa")[step - 20 : step]) == 0
    r.samples.loc[rests, TIP] = r.samples.loc[rests[0], TIP].to_numpy(float)
    assert not [f for f in check(r)[1] if f.kind in ("frozen", "saturated")]


@pytest.mark.parametrize("step_mm", [0.5, 2.0])
def test_a_coarse_tracker_that_reaches_its_last_number_now_and_then_saturates_nowhere(r, step_mm):
    r.samples[TIP] = (r.samples[TIP] / step_mm).round() * step_mm
    assert not [f for f in check(r)[1] if "sticks to its" in str(f)]


def test_a_pause_within_a_trial_is_a_gap(r):
    r.samples.loc[1500 : r.trials()[0].stop - 1, "time_s"] += 5.0
    f = only(r)
    assert (f.kind, f.numbers["count"]) == ("gaps", 1) and "1 gap (the longest 5.0 s" in f.sentence


@pytest.mark.parametrize("each", [2, 5])
def test_a_gauge_that_repeats_its_readings_tells_how_often(clean, each):
    f = only(by_trial(clean, "pressure_kpa", lambda x: np.repeat(x[::each], each)[: len(x)]))
    assert (f.kind, f.columns, f.numbers["rows_each"]) == ("repeated", ("pressure_kpa",), each)
    assert f"each value {each} times" in f.sentence


def test_a_gauge_that_is_read_now_and_then_repeats_too(clean):
    rng = np.random.default_rng(0)

    def hold(x):
        new = np.r_[True, rng.random(len(x) - 1) < 0.4]
        return x[np.maximum.accumulate(np.where(new, np.arange(len(x)), 0))]

    f = only(by_trial(clean, "pressure_kpa", hold))
    assert f.kind == "repeated" and f.numbers["rows_each"] == pytest.approx(2.5, rel=0.2)


def test_an_ideal_gauge_that_follows_a_stair_of_short_steps_repeats_nothing(r):
    stair = np.repeat(np.random.default_rng(0).uniform(0, 30, len(r) // 5 + 1), 5)[: len(r)]
    r.samples["pressure_cmd_kpa"] = r.samples["pressure_kpa"] = stair
    assert "repeated" not in {f.kind for f in findings(r)}


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_coarse_gauge_tells_its_step(clean, noise):
    rng = np.random.default_rng(1)
    step = 0.03 * clean.column("pressure_cmd_kpa").max()

    def read(x):
        return step * np.round(x / step) + noise * step * rng.normal(size=len(x))

    f = only(by_trial(clean, "pressure_kpa", read))
    assert f.kind == "quantised" and f.numbers["step"] == pytest.approx(step, rel=0.03)


def test_a_fine_gauge_whose_noise_hides_its_step_is_not_coarse(clean):
    step = 0.5 * np.diff(clean.column("pressure_kpa"))[:25].std()  # at rest
    assert findings(by_trial(clean, "pressure_kpa", lambda x: step * np.round(x / step))) == []


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("gauge", [True, False])
def test_a_command_that_is_written_late_is_found_at_its_steps(clean, rows, gauge):
    r = by_trial(clean, "pressure_cmd_kpa", lambda u: np.r_[np.full(rows, u[0]), u[:-rows]])
    if not gauge:
        r.samples = r.samples.drop(columns="pressure_kpa")
    (f,) = [f for f in findings(r) if f.kind == "late_command"]
    assert f.numbers["rows_late"] == rows and f"move it up by {rows} row" in f.sentence


def loop(seen, written=0, n=3000, every=1, gauge=False):
    """A body of first order under a controller that knows the pose of the row `seen` before its own.

    The command is written `written` rows late; with None for `seen` it is a program.
    """
    rng = np.random.default_rng(3)
    u, p, y = np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(1, n):
        p[k] = 0.3 * p[k - 1] + 0.7 * u[k - 1] + 0.02 * rng.normal()
        y[k] = 0.8 * y[k - 1] + 0.2 * p[k] + 0.2 * rng.normal()
        goal = 20 + 10 * np.sin(k / 60)
        if k % every:
            u[k] = u[k - 1]
        elif seen is None:
            u[k] = goal + 3 * rng.normal()
        else:
            u[k] = u[k - 1] + 0.3 * (goal - y[k - seen])
    u = np.r_[np.zeros(written), u[: n - written]]
    s = {"trial": 0, "time_s": np.arange(n) / 20, "pressure_cmd_kpa": u}
    s |= {"pressure_kpa": p} if gauge else {}
    return Recording(Path("r"), {}, pd.DataFrame(s | {"bend_angle_rad": y / 40}), "finger")


@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize(("seen", "same_row"), [(0, 1.0), (1, 0.0), (None, None)])
def test_feedback_is_found_by_the_row_of_which_it_knows(seen, same_row, every):
    found = [f for f in findings(loop(seen, every=every)) if f.kind == "closed_loop"]
    if seen is None:
        assert found == []
    else:
        assert found[0].numbers["same_row"] == same_row
        assert ("pose of its own row" in found[0].sentence) == bool(same_row)


def late_loop(feedback=0.0, hz=30, n=4000):
    """A computer that asks a clock where its program is, moves, and is late now and then; logged afterwards.

    The valve swings a little; `feedback` is what it answers to the pose's noise, kPa/rad.
    """
    rng = np.random.default_rng(7)
    step = rng.normal(1, 0.05, n) + (rng.random(n) < 0.01) * rng.exponential(1.0, n)
    tick = np.cumsum(np.maximum(step, 0.4)) / hz
    u, y, bend, speed = np.zeros(n - 1), np.zeros(n - 1), 0.0, 0.0
    for k in range(n - 1):
        u[k] = 18 - 9 * np.cos(0.8 * tick[k]) - 6 * np.cos(1.7 * tick[k])
        u[k] -= feedback * (y[k - 1] - bend) if k else 0.0
        dt = (tick[k + 1] - tick[k]) / 10
        for _ in range(10):
            speed += (14.0**2 * (u[k] / 40 - bend) - 20.0 * speed) * dt
            bend += speed * dt
        y[k] = bend + 0.001 * rng.normal()
    s = {"trial": 0, "time_s": tick[1:], "pressure_cmd_kpa": u, "bend_angle_rad": y}
    return Recording(Path("r"), {}, pd.DataFrame(s), "finger")


def test_a_program_of_a_late_loop_follows_nothing_and_lacks_no_row():
    kinds = {f.kind for f in findings(late_loop())}
    assert not kinds & {"closed_loop", "missing_rows"}
    assert "closed_loop" in {f.kind for f in findings(late_loop(feedback=40.0))}
    even, seen = late_loop(), np.random.default_rng(2).random(3999) > 0.02
    even.samples["time_s"] = np.arange(3999) / 30
    dropped = even.keep(seen)
    assert "missing_rows" in {f.kind for f in findings(dropped)}


@pytest.mark.parametrize("seen", [1, None])
@pytest.mark.parametrize("written", [0, 2, 3])
def test_a_gauge_that_is_ahead_of_an_ever_changing_command_is_found(seen, written):
    found = [f for f in findings(loop(seen, written, gauge=True)) if f.kind == "late_command"]
    # the body gets each command one row after it was sent
    assert [f.numbers["rows_late"] for f in found] == ([written - 1] if written else [])


def test_a_command_in_the_place_of_its_measured_pressure_is_found(clean, r):
    names = {"pressure_kpa": "pressure_cmd_kpa", "pressure_cmd_kpa": "pressure_kpa"}
    r.samples = r.samples.rename(columns=names)
    assert only(r).kind == "exchanged_pressures" and "scatters where" in only(r).sentence
    p, u = clean.column("pressure_kpa").copy(), np.zeros(len(clean))
    for i in range(1, len(u)):  # without noise: a valve of half a second behind stairs
        p[i] = clean.column("pressure_cmd_kpa").max() * (i // 40 * 7 % 11) / 10
        u[i] = u[i - 1] + 0.3 * (p[i] - u[i - 1])
    r.samples = r.samples.assign(pressure_cmd_kpa=u, pressure_kpa=p)
    found = [f for f in findings(r) if f.kind == "exchanged_pressures"]
    assert len(found) == 1 and "runs after 'pressure_kpa'" in found[0].sentence


def test_a_tip_that_no_pressure_moves_is_found(r):
    rng = np.random.default_rng(0)
    for name in TIP:
        r.samples[name] = r.samples[name].iloc[0] + rng.normal(0, 0.2, len(r))
    assert "explains 0." in only(r).sentence and only(r).kind == "unmoved"


def test_a_tracker_that_writes_zeros_jumps_and_does_not_saturate(r):
    at = np.arange(60, len(r), 97)
    r.samples.loc[at, TIP] = 0.0
    assert "saturated" not in {f.kind for f in findings(r)} and findings(r)[0].kind == "jumps"


def turning(clean):
    """The bend, enlarged so that it passes half a turn, with a tracker's noise."""
    bend = 4.5 * clean.column("tip_z_mm") / clean.column("tip_z_mm").max()
    return np.convolve(bend, np.ones(5) / 5, "same")


def test_an_angle_that_wraps_is_unwrapped_where_that_is_certain(clean, r):
    bend = turning(clean)
    r.samples["bend_angle_rad"] = (bend + np.pi) % (2 * np.pi) - np.pi
    f = only(r)
    assert (f.kind, f.numbers["unwrapped"]) == ("wrapped_angle", 1.0) and len(f.rows) > 10
    np.testing.assert_allclose(check(r)[0].column("bend_angle_rad"), bend, atol=1e-9)


def test_an_angle_that_wraps_in_a_wild_signal_is_kept_and_reported(clean, r):
    rng = np.random.default_rng(0)
    wild = turning(clean) + 0.5 * rng.normal(size=len(r))
    r.samples["bend_angle_rad"] = (wild + np.pi) % (2 * np.pi) - np.pi
    f = next(f for f in findings(r) if f.kind == "wrapped_angle")
    assert f.numbers["unwrapped"] == 0.0
    kept = check(r)[0]
    assert set(kept.column("bend_angle_rad")) <= set(r.column("bend_angle_rad"))


def test_rows_that_an_even_clock_lacks_are_counted(clean):
    keep = np.ones(len(clean), bool)
    keep[[500, 900, 901, 1500]] = False
    f = only(clean.keep(keep))
    assert (f.kind, f.numbers["count"]) == ("missing_rows", 4) and list(f.rows) == [500, 899, 1497]
    assert "dropped, or left out because the tip was not seen" in f.sentence
    r = clean.keep(keep)
    r.meta["conversion"] = {"rows_left_out": 3}
    assert "the conversion left out 3 without a tip, 1 were not logged" in only(r).sentence
    uneven = copy(clean)
    uneven.samples["time_s"] += np.random.default_rng(0).uniform(-0.012, 0.012, len(clean))
    assert findings(uneven.keep(keep)) == []


@pytest.mark.parametrize("every", [20, 60])
def test_poses_that_are_repeated_are_found_and_left_out_where_they_are_few(r, every):
    at = np.arange(7, len(r), every)
    r.samples.loc[at, TIP] = r.samples.loc[at - 1, TIP].to_numpy()
    f, left = only(r), check(r)[0]
    assert f.kind == "stale_pose" and f.numbers["share"] == pytest.approx(1 / every, abs=0.002)
    assert set(at) - set(f.rows) <= {int(s.start) for s in r.trials().values()}
    few = every == 60  # a tracker that is slower than the log repeats more
    assert len(r) - len(left) == few * len(f.rows) and ("left out" in f.sentence) == few


@pytest.mark.parametrize("pair", [("tip_y_mm", "tip_z_mm"), ("tip_x_mm", "tip_z_mm")])
def test_axes_in_each_others_place_are_named(clean, r, pair):
    r.samples[list(pair)] = clean.samples[list(pair[::-1])].to_numpy()
    f = only(r)
    assert f.kind == "exchanged_axes" and set(f.columns) == set(pair)


def test_a_steady_drift_is_found_and_measured(clean, r):
    r.samples["tip_x_mm"] += np.linspace(0, 6, len(r))
    f = only(r)
    assert f.kind == "drift" and set(f.numbers) == {"tip_x_mm"}
    assert f.numbers["tip_x_mm"] == pytest.approx(6, rel=0.2)
    wandering = copy(clean)
    wandering.samples["tip_x_mm"] += 3 * np.sin(np.linspace(0, 12, len(r)))
    assert findings(wandering) == []


def test_an_output_that_sticks_to_its_extreme_is_found_and_left_out(clean):
    limit = np.quantile(clean.column("tip_z_mm"), 0.9)
    clipped = by_trial(clean, "tip_z_mm", lambda x: np.minimum(x, limit))
    f = only(clipped)
    assert (f.kind, f.columns, f.numbers) == ("saturated", ("tip_z_mm",), {"at": limit, "kept": 0})
    assert f"{len(f.rows)} rows are left out; record within its range" in f.sentence
    left = check(clipped)[0]
    assert len(left) == len(clean) - len(f.rows) and left.column("tip_z_mm").max() < limit


def test_a_finger_that_friction_holds_sticks_too_and_is_not_left_out(clean, r):
    """Without noise, by the same numbers over and over, at rest and where the pressure turns."""
    share = np.abs((np.arange(len(clean)) * 0.05) % 20 / 10 - 1)
    held = np.full(len(r), 0.9)
    for k in range(1, len(r)):  # the play operator
        held[k] = np.clip(held[k - 1], share[k] - 0.1, share[k] + 0.1).round(6)
    for name, values in (("pressure_cmd_kpa", 15 * share), ("pressure_kpa", 15 * share), (TIP[2], 30 * held)):
        r.samples[name] = values
    found = [f for f in findings(r) if f.kind == "saturated" and f.columns == ("tip_z_mm",)]
    assert len(found) == 2 and all(f.numbers["kept"] for f in found)
    assert all("leave those rows out, or record within its range" in f.sentence for f in found)
    assert check(r)[0].column("tip_z_mm").max() == r.column("tip_z_mm").max()


def test_a_command_that_the_log_clipped_is_found(clean):
    limit = 0.7 * clean.column("pressure_cmd_kpa").max()
    f = only(by_trial(clean, "pressure_cmd_kpa", lambda u: np.minimum(u, limit)))
    assert (f.kind, f.columns, f.numbers["at"]) == ("clipped_command", ("pressure_cmd_kpa",), limit)


def test_a_gauge_whose_scale_is_off_is_in_no_other_unit_and_left_out(clean):
    for factor in (0.5, 1.3, 4.0):
        r = by_trial(clean, "pressure_kpa", lambda x, f=factor: f * x)
        f = only(r)
        assert f.kind == "gauge_scale" and f.numbers["ratio"] == pytest.approx(factor, rel=0.02)
        assert not check(r)[0].has("pressure_kpa")
    assert findings(by_trial(clean, "pressure_kpa", lambda x: 0.9 * x)) == []
