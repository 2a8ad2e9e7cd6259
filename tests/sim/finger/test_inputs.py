import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, Inputs, simulate
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


def test_other_chambers_on_record_become_conditions():
    t = table() | {"segment2_cmd_1_kpa": np.arange(120.0), "supply_kpa": np.ones(120)}
    c = Inputs.from_samples(t).conditions(("other_1_kpa", "other_2_kpa", "other_3_kpa"))
    np.testing.assert_array_equal(c, np.c_[np.arange(120.0), np.ones(120), np.zeros(120)])
    assert "other_1_kpa" not in Inputs.from_samples(table()).columns


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
