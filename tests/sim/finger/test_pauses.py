"""Pauses before runs that nobody logged: of a body that creeps, against the closed form of its memory."""

import numpy as np
import pandas as pd
import pytest

from pneutac_sim.finger import BodyData, Inputs, Pipeline
from pneutac_sim.finger.instants import pauses, pauses_read
from pneutac_sim.twin import Twin, Value

DT_S, TAU_S, SHARE = 0.1, 20.0, 0.3
TRUE_S = [0.0, 30.0, 4.0, 12.0, 2.0]
GAIN = 0.01


class Log:
    device = "finger"

    def __init__(self, samples, trials=None):
        self.samples, self.meta = samples, {"trials": trials or {}}


def log(noise_rad=0.0) -> pd.DataFrame:
    """Runs of 40 s under 60, 20 and 40 kPa; the angle follows a share of the pressure 20 s late."""
    rng, rows, memory = np.random.default_rng(4), [], 0.0
    for trial, pause in enumerate(TRUE_S):
        memory *= np.exp(-pause / TAU_S)
        for i, p in enumerate(np.repeat([60.0, 20.0, 40.0], 133)):
            memory = p + (memory - p) * np.exp(-DT_S / TAU_S)
            angle = GAIN * ((1 - SHARE) * p + SHARE * memory)
            rows.append((trial, i * DT_S, p, angle + noise_rad * rng.normal()))
    return pd.DataFrame(rows, columns=["trial", "time_s", "pressure_cmd_kpa", "bend_angle_rad"])


def twin(remembers=True) -> Twin:
    out = Twin("finger", 100.0, [50.0])
    out.parameters |= {
        "gain_rad_per_kpa": Value(GAIN),
        "rest_pressure_kpa": Value(0.0),
        "pause_s": Value(9.0),
    }
    if remembers:
        out.effects["lag(p)"] = {"weight": Value(SHARE), "time_s": Value(TAU_S), "scale_kpa": Value(1.0)}
    return out


def found(recording, of):
    data = BodyData.of(recording, of, source="command")
    model = Pipeline.of(of, data.inputs)
    theta = model.theta(of, data.inputs.pressure_range_kpa)
    return pauses(recording, data, np.arange(len(data)), model, theta)


def error(recording, of, start):
    data = BodyData.of(recording, of, source="command", start=start)
    model = Pipeline.of(of, data.inputs)
    run = model.run(data.inputs, model.theta(of, data.inputs.pressure_range_kpa))
    return float(np.sqrt(((model.outputs(run, data.columns) - data.measured) ** 2).mean()))


def test_a_body_that_creeps_shows_how_long_it_rested():
    recording = Log(log(noise_rad=0.002))
    own = found(recording, twin())
    np.testing.assert_allclose(own[1:], TRUE_S[1:], rtol=0.15)
    assert error(recording, twin(), own) < 0.0022 < 0.006 < error(recording, twin(), 9.0)


def test_what_is_stated_stays_and_is_read_as_if_it_had_been_found():
    table = log()
    stated = {str(i): {"start": "continues", "pause_s": s} for i, s in enumerate(TRUE_S)}
    assert found(Log(table, stated), twin()) is None
    as_found = error(Log(table), twin(), tuple(TRUE_S))
    assert error(Log(table, stated), twin(), "auto") == pytest.approx(as_found)
    for how in ({}, {"3": {"start": "unknown"}}, {"3": {"start": "continues"}}):
        partly = Log(table, {k: v for k, v in stated.items() if k != "3"} | how)
        data = BodyData.of(partly, twin(), source="command", start=found(partly, twin()))
        assert pauses_read(partly, data).item() == pytest.approx(12, rel=0.1)


def test_a_body_without_memory_has_no_pauses_and_noise_alone_shows_none():
    assert found(Log(log()), twin(remembers=False)) is None
    table = log()
    table["bend_angle_rad"] = 0.5 + 0.1 * np.random.default_rng(1).normal(size=len(table))
    weak = twin()
    weak.effects["lag(p)"]["weight"] = Value(1e-6)
    assert found(Log(table), weak) == (9.0,) * 5


def test_the_session_goes_on_over_a_stated_pause_where_each_clock_begins_anew():
    table = log()
    stated = {"1": {"start": "continues", "pause_s": 30.0}, "2": {"start": "rested"}}
    t = Inputs.from_samples(table, trials=stated).columns["session_time_s"]
    last = [table.time_s[table.trial == k].max() for k in range(3)]
    data = Inputs.from_samples(table, trials=stated)
    first = t[data.rows[np.flatnonzero(np.diff(table.trial)) + 1]]
    np.testing.assert_allclose(first[0], last[0] + 30.0)
    np.testing.assert_allclose(first[1], first[0] + last[1])
