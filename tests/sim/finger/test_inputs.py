import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, Inputs, simulate
from pneutac_sim.finger.inputs import SWITCH_S
from pneutac_sim.twin import Twin


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
