"""Instants at which commands stepped, found again in recordings that were made with them.

What is measured, and in which order it counts.

The loaded spine against the energy it must minimise and against small-load beam statics.
"""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, Inputs, Pipeline, quantities, simulate
from pneutac_sim.finger.equilibrium import along_a_line, sensitivities, solve
from pneutac_sim.finger.inputs import SWITCH_S, steps
from pneutac_sim.finger.instants import COST, StepRows, instants, step_rows
from pneutac_sim.finger.stages import (
    forward_kinematics,
    forward_kinematics_spatial,
    gain_profile,
    joint_command,
)
from pneutac_sim.twin import Twin, Value


def table(levels=(5.0, 10.0, 15.0), n=40):
    m = len(levels)
    return {
        "trial": np.repeat(np.arange(m), n),
        "time_s": np.tile(np.arange(n) / 50, m),
        "pressure_cmd_kpa": np.repeat(levels, n).astype(float),
    }


def settle(t):
    return 1 - np.exp(-t["time_s"] / 0.1)


def test_every_trial_begins_after_a_long_rest():
    dt = Inputs.from_samples(table()).dt_s
    np.testing.assert_array_equal(np.flatnonzero(np.isinf(dt)), [0, 40, 80])
    np.testing.assert_allclose(dt[1:40], 0.02)


def test_steps_that_came_with_the_first_sample_are_found_by_the_poses():
    t = table()
    held = t | {"tip_z_mm": 2 * t["pressure_cmd_kpa"]}
    vented = t | {"tip_z_mm": 2 * t["pressure_cmd_kpa"] * settle(t)}
    assert len(Inputs.from_samples(held).dt_s) == 120
    inputs = Inputs.from_samples(vented)
    assert len(inputs.dt_s) == 123
    np.testing.assert_array_equal(inputs.pressure_kpa[[0, 41, 82], 0], 0)
    np.testing.assert_array_equal(inputs.pressure_kpa[inputs.rows, 0], t["pressure_cmd_kpa"])
    assert len(Inputs.from_samples(vented, start="held").dt_s) == 120


def test_a_vented_start_gives_the_lag_something_to_do():
    t = table()
    vented = t | {"tip_z_mm": 2 * t["pressure_cmd_kpa"] * settle(t)}
    twin = Twin.builtin()
    recording = type("Recording", (), {"samples": vented, "device": "finger"})
    moved = simulate(twin, BodyData.of(recording, twin), ["valve_lag"]).model[:, 0]
    rest = simulate(twin, BodyData.of(recording, twin, start="held"), ["valve_lag"]).model[:, 0]
    assert np.ptp(rest[:40]) < 1e-9 and np.ptp(moved[:40]) > 1


def test_session_time_runs_on_where_the_clock_of_each_trial_restarts():
    inputs = Inputs.from_samples(table())
    t = inputs.columns["session_time_s"]
    assert (np.diff(t) >= 0).all() and t[-1] == pytest.approx(3 * 0.78)
    running = table() | {"time_s": 100 + np.arange(120) * 0.1}
    np.testing.assert_allclose(
        Inputs.from_samples(running).columns["session_time_s"], np.arange(120) * 0.1, atol=1e-9
    )


def test_bad_inputs_are_refused():
    with pytest.raises(InputError, match="no column 'pressure_cmd_1_kpa'"):
        Inputs.from_samples(table(), "arm")
    with pytest.raises(InputError, match="row 6 does not rise"):
        t = table()
        t["time_s"][5] = 0.0
        Inputs.from_samples(t)
    with pytest.raises(InputError, match="source is 'gauge'"):
        Inputs.from_samples(table(), source="gauge")
    twin = Twin.builtin()
    recording = type("Recording", (), {"samples": table(), "device": "finger"})
    with pytest.raises(InputError, match="no tip_x_mm"):
        BodyData.of(recording, twin)
    with pytest.raises(InputError, match="no measured pressure"):
        BodyData.of(recording, twin, target="pressure")
    with pytest.raises(InputError, match="of a finger, the twin is of a arm|recording is of a finger"):
        BodyData.of(recording, Twin(device="arm"))


# ---------------------------------------------------------------- pauses between trials


def lagged(inputs, tau):
    """Samples (n,) of a first-order lag of the pressure, by the equation from row to row."""
    effect = get_effect("valve_lag")
    state = np.zeros(effect.state_size(1))
    values = {"fill_time_s": tau, "vent_time_s": tau}
    return effect.apply(inputs.pressure_kpa, inputs.dt_s, values, state=state)[inputs.rows, 0]


def test_a_lag_carries_over_a_pause_by_the_exponential():
    t, tau = table(levels=(8.0, 0.0, 8.0), n=400), 2.0
    for pause in (0.5, 3.0, 7.0):
        y = lagged(Inputs.from_samples(t, start=pause), tau)
        gone = pause + 3 / 50  # it vents within a sample, waits, and goes on within a sample
        assert y[400] / y[399] == pytest.approx(np.exp(-gone / tau), rel=0.02)
    assert lagged(Inputs.from_samples(t, start="vented"), tau)[400] == 0.0
    assert lagged(Inputs.from_samples(t, start="held"), tau)[399] == pytest.approx(8.0)
    before_all = Inputs.from_samples(t, start=3.0)
    assert lagged(before_all, tau)[0] < 0.1 and np.isinf(before_all.dt_s).sum() == 1
    np.testing.assert_array_equal(before_all.pressure_kpa[before_all.rows, 0], t["pressure_cmd_kpa"])


def test_what_is_known_of_single_trials_goes_before_what_is_thought_of_all():
    t = table(levels=(8.0, 4.0, 6.0), n=100)
    known = {"1": {"start": "continues", "pause_s": 5.0}, "2": {"start": "rested"}}
    inputs = Inputs.from_samples(t, start="held", trials=known)
    assert np.isinf(inputs.dt_s).sum() == 2  # trial 1 goes on from trial 0, trial 2 rested at zero
    assert 5.0 in inputs.dt_s and len(inputs.dt_s) == 300 + 2 + 1
    first = inputs.rows[[0, 100, 200]]
    assert first[0] == 0 and inputs.pressure_kpa[first[1:] - 1, 0].tolist() == [0.0, 0.0]
    assert np.isinf(inputs.dt_s[first[2] - 1])
    nothing = Inputs.from_samples(t, start="held")
    np.testing.assert_array_equal(inputs.sample_dt_s[1:100], nothing.sample_dt_s[1:100])


# ---------------------------------------------------------------- instants at which commands step


def test_a_step_happens_at_its_instant_between_two_samples():
    t, tau = table(levels=(0.0,), n=100), 0.3
    t["pressure_cmd_kpa"][50:] = 8.0
    for share in (0.1, 0.5, 0.9):
        y = lagged(Inputs.from_samples(t, start="held", switch=share), tau)
        since = (np.arange(50, 100) - 50 + 1 - share) / 50
        np.testing.assert_allclose(y[50:], 8.0 * (1 - np.exp(-since / tau)), atol=8.0 * SWITCH_S / tau)
        assert not y[:50].any()
    straight = lagged(Inputs.from_samples(t, start="held"), tau)
    assert straight[50] == pytest.approx(8.0 * (1 - (1 - np.exp(-1 / 15)) * 15), rel=1e-6)


def test_each_step_may_have_its_own_instant_and_the_time_of_sending_goes_before_it():
    t = table(levels=(0.0,), n=100)
    t["pressure_cmd_kpa"][[*range(20, 50), *range(70, 100)]] = 8.0
    share = np.full(100, np.nan)
    share[[20, 50, 70]] = 0.2, 0.4, 0.8
    one = Inputs.from_samples(t, start="held", switch=share)
    assert len(one.dt_s) == 100 + 2 * 3
    t["time_sent_s"] = t["time_s"] - np.nan_to_num((1 - share) / 50)
    sent = Inputs.from_samples(t, start="held", switch=0.5)
    np.testing.assert_allclose(sent.dt_s, one.dt_s, atol=1e-12)
    np.testing.assert_array_equal(sent.pressure_kpa, one.pressure_kpa)
    assert one.dt_s[1:].sum() == pytest.approx(99 / 50)


def test_chambers_that_step_one_sample_after_another_both_step_when_their_commands_were_sent():
    p = np.zeros((40, 2))
    p[10:, 0], p[11:, 1] = 10.0, 8.0
    np.testing.assert_array_equal(steps(p, np.arange(40) == 0), [10, 11])
    sent = np.where(np.arange(40) < 10, 0.0, np.where(np.arange(40) == 10, 0.47, 0.53))
    made = Inputs.from_samples(
        {
            "trial": np.zeros(40, int), "time_s": np.arange(40) / 20, "time_sent_s": sent,
            "pressure_cmd_1_kpa": p[:, 0], "pressure_cmd_2_kpa": p[:, 1],
            "pressure_cmd_3_kpa": np.zeros(40),
        },
        "arm",
    )  # fmt: skip
    time = np.cumsum(np.where(np.isinf(made.dt_s), 0.0, made.dt_s))
    for chamber, at in ((0, 0.47), (1, 0.53)):
        before = made.pressure_kpa[:, chamber] == 0
        assert time[before].max() == pytest.approx(at) and time[~before].min() == pytest.approx(at + SWITCH_S)


@pytest.mark.parametrize("tick", (0.037, 0.05), ids=("beside the log", "each command logged"))
def test_commands_of_a_ramp_are_held_until_the_next_where_the_log_tells_when_each_was_sent(tick):
    sent = np.arange(0.003, 10, tick)
    height = 5 + 5 * np.sin(3 * sent)
    fine = np.arange(0, 10, 1e-4)
    last = np.maximum(np.searchsorted(sent, fine + 1e-9, side="right") - 1, 0)
    rows = np.arange(500, len(fine), 500)  # 20 Hz
    table = {"time_s": fine[rows], "pressure_cmd_kpa": height[last[rows]], "time_sent_s": sent[last[rows]]}
    inputs = Inputs.from_samples(table, start="held")
    clock = table["time_s"][0] + np.cumsum(np.r_[0, inputs.dt_s[1:]])
    np.testing.assert_allclose(inputs.pressure_kpa[inputs.rows, 0], table["pressure_cmd_kpa"], atol=1e-12)

    late, truth = fine[1000:], height[last[1000:]]
    held = np.interp(late, clock, inputs.pressure_kpa[:, 0]) - truth
    straight = np.interp(late, table["time_s"], table["pressure_cmd_kpa"]) - truth
    assert np.sqrt(np.mean(held**2)) < 0.2 * np.sqrt(np.mean(straight**2))


def test_thinned_inputs_are_observed_at_fewer_samples_of_the_same_time():
    t = table(levels=(8.0, 4.0), n=100)
    inputs = Inputs.from_samples(t, start=2.0)
    keep = np.array([3, 50, 99, 100, 160])
    thin = inputs.thin(keep)
    np.testing.assert_array_equal(lagged(thin, 1.0), lagged(inputs, 1.0)[keep])
    clock = np.cumsum(np.where(np.isinf(inputs.dt_s), 0, inputs.dt_s))[inputs.rows]
    np.testing.assert_allclose(thin.sample_dt_s[1:], np.diff(clock[keep]))
    assert np.isinf(thin.sample_dt_s[0])


HZ, HOLD, STEPS = 25, 40, 24


@pytest.fixture(scope="module")
def made():
    """A finger with a quick valve, stepped at random instants: these, twin, pipeline, theta, recording."""
    rng = np.random.default_rng(0)
    levels = rng.uniform(0, 5, STEPS + 1)
    levels[1::2] += 10.0
    p = np.repeat(levels, HOLD)
    n = len(p)
    samples = pd.DataFrame({"trial": 0, "time_s": np.arange(n) / HZ, "pressure_cmd_kpa": p})
    samples[["tip_x_mm", "tip_z_mm"]] = 0.0
    recording = SimpleNamespace(samples=samples, device="finger", meta={})
    twin = Twin.builtin()
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.15), "vent_time_s": Value(0.15)}
    share = np.full(n, np.nan)
    share[step_rows(recording)] = rng.uniform(0.03, 0.97, len(step_rows(recording)))
    data = BodyData.of(recording, twin, start="held", switch=share)
    pipeline = Pipeline.of(twin, data.inputs)
    theta = pipeline.theta(twin)
    tip = pipeline.outputs(pipeline.run(data.inputs, theta), data.columns)
    samples[list(data.columns)] = tip + 0.02 * rng.normal(size=tip.shape)
    return share, twin, pipeline, theta, recording


def test_instants_are_found_within_a_twentieth_of_a_sample(made):
    share, twin, pipeline, theta, recording = made
    found = instants(
        recording, lambda s: BodyData.of(recording, twin, start="held", switch=s), pipeline, theta
    )
    at = step_rows(recording)
    assert len(at) == STEPS and np.isfinite(found[at]).all() and np.isnan(np.delete(found, at)).all()
    assert np.abs(found - share)[at].max() < 0.05


@pytest.mark.parametrize("held", (True, False))
def test_without_a_step_the_commands_of_a_motion_are_held_as_usual_where_that_fits_better(held):
    """A loop at 10 Hz whose rows have the command that was sent at the row before, or one that ramps."""
    rng, ms = np.random.default_rng(4), 100
    rows = np.arange(0, 60_000, ms)
    kpa = 8 + 6 * np.sin(2e-3 * rows)
    fine = np.arange(rows[-1] + 1)
    table = {"trial": np.zeros(len(fine), int), "time_s": fine / 1e3}
    now = (
        kpa[np.minimum(np.ceil(fine / ms).astype(int), len(kpa) - 1)] if held else np.interp(fine, rows, kpa)
    )
    twin = Twin.builtin()
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.1), "vent_time_s": Value(0.1)}
    truth = Inputs.from_samples(table | {"pressure_cmd_kpa": now}, start="held")
    pipeline = Pipeline.of(twin, truth)
    theta = pipeline.theta(twin)
    names = ["tip_x_mm", "tip_z_mm"]
    tip = pipeline.outputs(pipeline.run(truth, theta), tuple(names))[rows]
    samples = pd.DataFrame({"trial": 0, "time_s": rows / 1e3, "pressure_cmd_kpa": kpa})
    samples[names] = tip + 0.2 * rng.normal(size=tip.shape)
    recording = SimpleNamespace(samples=samples, device="finger", meta={})

    def read(share):
        return BodyData.of(recording, twin, start="held", switch=share)

    def error(share):
        data = read(share)
        return data.error(pipeline.outputs(pipeline.run(data.inputs, theta), data.columns) - data.measured)

    found = instants(recording, read, pipeline, theta, usual=0.02)
    assert np.isfinite(found).all() if held else np.isnan(found).all()
    assert error(found) < 1.3 * 0.2 * np.sqrt(2)
    assert not held or error(None) > 2 * error(found)
    assert instants(recording, read, pipeline, theta) is None


def test_the_step_that_begins_a_motion_is_found_among_commands_that_no_row_has():
    """A computer that sends every 35 ms beside a log at 20 Hz: rows have the last command alone."""
    rng = np.random.default_rng(3)
    tick, row, seconds = 0.035, 50, 3.0  # s, ms, s
    dense, began = [], []
    for trial in range(16):
        sent = rng.uniform(0, tick) + tick * np.arange(int(seconds / tick))
        began.append(sent[rng.integers(20, 60)])
        height = np.where(sent < began[-1], 0.0, 8 + 4 * np.sin(3 * (sent - began[-1])))
        changed = np.maximum.accumulate(np.where(np.diff(height, prepend=-1) != 0, np.arange(len(sent)), 0))
        fine = np.arange(round(seconds * 1e3)) / 1e3
        last = np.searchsorted(sent, fine + 1e-9, side="right") - 1
        table = {"time_s": fine, "pressure_cmd_kpa": np.where(last < 0, 0.0, height[last])}
        table["time_sent_s"] = np.where(last < 0, 0.0, sent[changed[last]])
        dense.append(pd.DataFrame({"trial": trial} | table))
    dense = pd.concat(dense, ignore_index=True)
    samples = dense[::row].copy()
    twin = Twin.builtin()
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.1), "vent_time_s": Value(0.1)}
    truth = Inputs.from_samples(dense.drop(columns="time_sent_s"), start="held", switch=0.5)
    pipeline = Pipeline.of(twin, truth)
    theta = pipeline.theta(twin)
    names = ("tip_x_mm", "tip_z_mm")
    tip = pipeline.outputs(pipeline.run(truth, theta), names)[samples.index]
    samples[list(names)] = tip + 0.2 * rng.normal(size=tip.shape)
    recording = SimpleNamespace(samples=samples.reset_index(drop=True), device="finger", meta={})

    def read(share):
        return BodyData.of(recording, twin, start="held", switch=share)

    found = instants(recording, read, pipeline, theta)
    at = step_rows(recording)
    time, sent = (recording.samples[c].to_numpy() for c in ("time_s", "time_sent_s"))
    unseen = np.isfinite(found[at])
    assert 3 < unseen.sum() < len(at) == 16  # of the others no command is hidden
    assert np.abs(sent[at] - began)[~unseen].max() < 1e-9 < tick - 0.002 < np.abs(sent[at] - began).max()
    instant = time[at - 1] + found[at] * (time[at] - time[at - 1])
    assert np.abs(instant - began)[unseen].max() < tick / 3

    def error(share):
        data = read(share)
        return data.error(pipeline.outputs(pipeline.run(data.inputs, theta), data.columns) - data.measured)

    assert error(found) < 1.1 * 0.2 * np.sqrt(2) < 0.75 * error(None)


def test_where_the_time_of_sending_is_known_nothing_is_sought(made):
    _, twin, pipeline, theta, recording = made

    def read(share):
        raise AssertionError("nothing needs to be simulated")

    sent = recording.samples.assign(time_sent_s=recording.samples["time_s"])
    assert instants(SimpleNamespace(samples=sent, device="finger"), read, pipeline, theta) is None
    still = recording.samples.assign(pressure_cmd_kpa=np.linspace(0, 5, len(recording.samples)))
    assert instants(SimpleNamespace(samples=still, device="finger"), read, pipeline, theta) is None


@pytest.fixture(scope="module")
def quick():
    """A finger without a valve, seen by a model with a quick one: rows after steps, pipeline, theta."""
    rng, hold = np.random.default_rng(1), 8
    p = np.repeat(rng.uniform(0, 15, 150), hold)
    samples = pd.DataFrame({"trial": 0, "time_s": np.arange(len(p)) / 10, "pressure_cmd_kpa": p})
    samples["bend_angle_rad"] = 0.0
    recording = SimpleNamespace(samples=samples, device="finger", meta={})
    plain, twin = Twin.builtin(), Twin.builtin()
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.015), "vent_time_s": Value(0.015)}
    data = BodyData.of(recording, plain)
    pipeline = Pipeline.of(plain, data.inputs)
    bend = pipeline.outputs(pipeline.run(data.inputs, pipeline.theta(plain)), data.columns)[:, 0]
    samples["bend_angle_rad"] = bend + 0.01 * rng.normal(size=len(p))
    step = StepRows(recording, lambda s: BodyData.of(recording, twin, start="held", switch=s))
    pipeline = Pipeline.of(twin, BodyData.of(recording, twin, start="held", switch=0.5).inputs)
    return step, pipeline, pipeline.theta(twin)


def test_an_instant_fitted_to_a_row_hides_its_noise_and_a_judged_one_does_not(quick):
    step, pipeline, theta = quick
    fitted = step.errors(pipeline, theta).min(axis=0).sum() / step.own.sum()
    residual, added = step.judged(pipeline, theta, 0.01**2)
    judged = ((residual[..., 0] ** 2 + added) * step.own).sum() / step.own.sum()
    assert fitted < 0.95 * 0.01**2 <= judged < 1.2 * 0.01**2


def test_steps_at_instants_of_their_own_are_judged_at_them_for_the_cost_of_one_number_each(made):
    _, twin, pipeline, theta, recording = made
    step = StepRows(recording, lambda s: BodyData.of(recording, twin, start="held", switch=s))
    residual, added = step.judged(pipeline, theta, variance := 2 * 0.02**2)
    np.testing.assert_allclose((added * step.own).sum(axis=1), COST * variance)
    shared = step.errors(pipeline, theta).sum(axis=1).min()
    assert ((residual**2).sum(axis=2) * step.own).sum() < 0.02 * shared


def test_the_rows_of_a_step_end_at_the_next_one_and_with_the_trial():
    p = np.repeat([0.0, 5.0, 1.0, 9.0], [10, 3, 2, 15])
    samples = pd.DataFrame(
        {"trial": np.arange(30) // 26, "time_s": np.arange(30) / 10, "pressure_cmd_kpa": p}
    )
    samples["bend_angle_rad"] = 0.0
    recording = SimpleNamespace(samples=samples, device="finger", meta={})
    step = StepRows(recording, lambda s: BodyData.of(recording, Twin.builtin(), switch=s))
    assert step.at.tolist() == [10, 13, 15] and step.own.sum(axis=1).tolist() == [3, 2, 6]


def test_curvature_counts_before_joint_angles():
    columns = ["q_1_rad", "curvature_x_1_per_m", "q_2_rad", "curvature_y_1_per_m"]
    assert quantities.headline(columns, "arm") == (["curvature_x_1_per_m", "curvature_y_1_per_m"], "1/m")
    assert quantities.headline(["q_1_rad", "tip_z_mm"], "finger") == (["tip_z_mm"], "mm")
    assert quantities.headline(["pressure_kpa"], "finger") == ([], "")
    assert quantities.observations(columns, "finger") == ["q_1_rad", "q_2_rad"], "of an arm alone"


JOINTS = np.array([13.75, 41.25, 68.75, 96.25])


@pytest.mark.parametrize("n", [1, 4, 6])
def test_profile_has_unit_mean_and_the_papers_ratios(n):
    r = gain_profile(n, 0.0313, 0.2974)
    assert r.mean() == pytest.approx(1, abs=1e-14)
    m = np.arange(1, n + 1) - (n + 1) / 2
    ratio = np.exp(0.0313 * m) * (1 + 0.2974 * m**2)
    np.testing.assert_allclose(r / r[0], ratio / ratio[0], rtol=1e-13)


def test_profile_refuses_joints_that_bend_backwards():
    with pytest.raises(InputError, match="gain_beta"):
        gain_profile(4, 0.0, -0.6)


def test_command_is_linear_in_pressure_and_zero_at_minus_rest_pressure():
    q = joint_command(np.array([-10.7, 0.0, 5.0, 10.0]), 0.01114, 0.03, 0.3, 10.7, 4)
    np.testing.assert_allclose(q[0], 0, atol=1e-15)
    np.testing.assert_allclose(q[3] - q[2], q[2] - q[1])
    np.testing.assert_allclose(q[1].sum(), 4 * 0.01114 * 10.7)


def test_spatial_bend_in_either_plane_equals_the_planar_finger():
    q = np.array([0.3, -0.1, 0.2, 0.4])
    planar, bend = forward_kinematics(q, JOINTS, 110.0)
    to_z, bend_z = forward_kinematics_spatial(np.stack([q, 0 * q], -1), JOINTS, 110.0)
    to_y, bend_y = forward_kinematics_spatial(np.stack([0 * q, q], -1), JOINTS, 110.0)
    np.testing.assert_allclose(to_z, [planar[0], 0, planar[1]], atol=1e-12)
    np.testing.assert_allclose(to_y, [planar[0], planar[1], 0], atol=1e-12)
    np.testing.assert_allclose(bend_z, [bend, 0])
    np.testing.assert_allclose(bend_y, [0, bend])


def test_spatial_tip_equals_the_product_of_rotations():
    rng = np.random.default_rng(1)
    q = rng.normal(scale=0.5, size=(20, 6, 2))
    q[0] = 0.0
    s_n = np.linspace(10, 100, 6)
    tip, _ = forward_kinematics_spatial(q, s_n, 110.0)
    links = np.diff(np.append(s_n, 110.0))
    for angles, found in zip(q, tip, strict=True):
        frame, end = Rotation.identity(), np.array([10.0, 0, 0])
        for (to_z, to_y), link in zip(angles, links, strict=True):
            frame = frame * Rotation.from_rotvec([0, -to_z, to_y])
            end = end + link * frame.apply([1, 0, 0])
        np.testing.assert_allclose(found, end, atol=1e-10)


def test_joints_out_of_order_are_refused():
    with pytest.raises(InputError, match="rise from base to tip"):
        forward_kinematics(np.zeros(2), np.array([50.0, 20.0]), 110.0)


L = 0.11
N = 4
S = L * (np.arange(N) + 0.5) / N
LINKS = np.diff(np.append(S, L))
K = 0.4


def _links():
    return np.concatenate([LINKS, LINKS / L])


def _points(q):
    """Joint positions and tip (N + 1, 3) for angles (N, 2), link 0 left out."""
    frame, points = Rotation.identity(), [np.zeros(3)]
    for n in range(N):
        frame = frame * Rotation.from_rotvec([0, -q[n, 0], q[n, 1]])
        points.append(points[-1] + LINKS[n] * frame.apply([1, 0, 0]))
    return np.array(points)


def _energy(q, free, load):
    p = _points(q)
    middle = 0.5 * (p[1:] + p[:-1])
    return 0.5 * K * ((q - free) ** 2).sum() - p[-1] @ load[:3] - (LINKS / L) @ middle @ load[3:]


@pytest.mark.parametrize("scale", [0.2, 1.0, 4.0])
def test_spatial_equilibrium_is_the_minimum_of_energy(scale):
    rng = np.random.default_rng(3)
    free = rng.normal(scale=0.2, size=(N, 2))
    load = scale * rng.normal(size=6)
    q = free.reshape(1, -1).copy()
    solve(q, load[None], K, _links(), np.zeros(2 * N))
    best = minimize(lambda v: _energy(v.reshape(N, 2), free, load), free.ravel(), options={"gtol": 1e-9})
    np.testing.assert_allclose(q[0], best.x, atol=2e-6)


def test_planar_equals_spatial_in_the_plane():
    rng = np.random.default_rng(4)
    free = rng.normal(scale=0.3, size=(20, N))
    loads = rng.normal(size=(20, 6))
    loads[:, [1, 4]] = 0
    a = free.copy()
    solve(a, loads, K, _links(), np.zeros(N))
    b = np.stack([free, 0 * free], -1).reshape(20, -1)
    solve(b, loads, K, _links(), np.zeros(2 * N))
    np.testing.assert_allclose(b.reshape(20, N, 2)[..., 0], a, atol=1e-9)
    np.testing.assert_allclose(b.reshape(20, N, 2)[..., 1], 0, atol=1e-12)


def test_small_tip_load_bends_each_joint_by_lever_times_force_over_stiffness():
    force = 1e-4
    q = np.zeros((1, N))
    solve(q, np.array([[0, 0, force, 0, 0, 0.0]]), K, _links(), np.zeros(N))
    np.testing.assert_allclose(q[0], force * (L - S) / K, rtol=1e-6)


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("spoilt", ["q", "loads", "stiffness"])
def test_what_is_not_finite_ends_at_once_and_is_no_number(axes, spoilt):
    """No shift makes a matrix of NaN positive definite: the search for one once went on for ever."""
    given = {"q": np.full((5, 4 * axes), 0.1), "loads": np.zeros((5, 6)), "stiffness": np.array([0.4])}
    given["loads"][:, 2] = 0.1
    given[spoilt][2 if spoilt != "stiffness" else 0] = np.nan
    links = np.concatenate([np.full(4, 0.025), np.full(4, 0.25)])
    solve(given["q"], given["loads"], given["stiffness"][0], links, np.zeros(4 * axes))
    first = 0 if spoilt == "stiffness" else 2
    assert np.isfinite(given["q"][:first]).all() and np.isnan(given["q"][first:]).all()


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("scale", [0.0, 0.3, 2.0])
def test_outputs_change_as_differences_of_solutions_do(axes, scale):
    rng, n = np.random.default_rng(6), 3
    free, loads = rng.normal(scale=0.3, size=(n, axes * N)), scale * rng.normal(size=(n, 6))
    by_markers = rng.normal(size=(n, 2, 5))
    if axes == 1:
        by_markers[:, :, [1, 4]] = 0.0

    def seen(free, loads, stiffness):
        q = free.copy()
        solve(q, loads, stiffness, _links(), np.zeros(axes * N))
        markers = np.zeros((n, 5))
        if axes == 1:
            tip, markers[:, 3] = forward_kinematics(q, 1e3 * S, 1e3 * L)
            markers[:, [0, 2]] = tip
        else:
            markers[:, :3], markers[:, 3:] = forward_kinematics_spatial(q.reshape(n, N, 2), 1e3 * S, 1e3 * L)
        return q, np.einsum("ndm,nm->nd", by_markers, markers)

    q, _ = seen(free, loads, K)
    by_free, by_load, by_stiffness = np.empty((n, 2, axes * N)), np.zeros((n, 2, 6)), np.zeros((n, 2))
    sensitivities(q, free, loads, K, _links(), by_markers, by_free, by_load, by_stiffness)

    def check(got, moved):
        slope = (moved(1e-4)[1] - moved(-1e-4)[1]) / 2e-4
        np.testing.assert_allclose(got, slope, atol=1e-5 * np.abs(slope).max() + 1e-4)

    for i, e in enumerate(np.eye(axes * N)):
        check(by_free[:, :, i], lambda d, e=e: seen(free + d * e, loads, K))
    for i, e in enumerate(np.eye(6)):
        check(by_load[:, :, i], lambda d, e=e: seen(free, loads + d * e, K))
    check(by_stiffness, lambda d: seen(free, loads, K + d))


def test_deflections_along_a_line_are_those_of_every_row():
    rng = np.random.default_rng(8)
    free = 0.1 + rng.uniform(0, 1, (2000, 1)) * np.array([[0.3, 0.25, 0.2, 0.3]])
    loads = np.repeat(0.5 * rng.normal(size=(4, 6)), 500, axis=0)
    expected = free.copy()
    solve(expected, loads, K, _links(), np.zeros(N))
    np.testing.assert_allclose(along_a_line(free, loads, K, _links()), expected, atol=1e-7)
    assert np.abs(expected - free).max() > 0.05
    assert along_a_line(free, rng.normal(size=(2000, 6)), K, _links()) is None
    free[3] = np.nan
    assert along_a_line(free, loads, K, _links()) is None
