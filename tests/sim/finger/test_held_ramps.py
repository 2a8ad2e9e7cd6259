"""Logs of a computer that holds each command until the next, against the closed form of a slow valve."""

import numpy as np
import pandas as pd
import pytest

from pneutac_sim.finger import BodyData, Inputs, Pipeline
from pneutac_sim.finger.instants import instants
from pneutac_sim.twin import Twin, Value

DT_S, TAU_S = 0.1, 0.15


def log(program: np.ndarray) -> pd.DataFrame:
    """Ten rows a second of commands sent at the rows, and a gauge behind a valve of 0.15 s, exactly."""
    p = np.full(len(program), program[0])
    for i in range(1, len(program)):
        p[i] = program[i - 1] + (p[i - 1] - program[i - 1]) * np.exp(-DT_S / TAU_S)
    table = {"trial": 0, "time_s": DT_S * np.arange(len(program)), "pressure_cmd_kpa": program}
    return pd.DataFrame(table | {"pressure_kpa": p, "tip_x_mm": 100.0, "tip_z_mm": 0.0})


def program() -> np.ndarray:
    """Steps of two seconds, then a wave of eight."""
    steps = np.repeat(np.random.default_rng(1).uniform(0, 60, 15), 20)
    return np.r_[steps, 30 - 30 * np.cos(2 * np.pi * DT_S * np.arange(320) / 8)]


class Log:
    device, meta = "finger", {}

    def __init__(self, samples):
        self.samples = samples


def test_a_wave_of_held_commands_is_read_as_held_where_its_valve_shows_it():
    recording, twin = Log(log(program())), Twin("finger", 100.0, [50.0])
    twin.effects["valve_lag"] = {"fill_time_s": Value(TAU_S), "vent_time_s": Value(TAU_S)}

    def read(share):
        return BodyData.of(recording, twin, source="command", target="pressure", switch=share)

    def error(share):
        data = read(share)
        model = Pipeline.of(twin, data.inputs)
        run = model.run(data.inputs, model.theta(twin))
        return np.abs(model.outputs(run, data.columns)[:, 0] - recording.samples["pressure_kpa"]).max()

    model = Pipeline.of(twin, read(0.5).inputs)
    found = instants(recording, read, model, model.theta(twin))
    assert np.nanmin(found) > 0.95  # commands were sent at the rows, also in the wave
    assert not np.isnan(found[310:]).any()
    assert error(found) < 0.4 < 1.0 < error(np.where(np.arange(len(found)) < 302, found, np.nan))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 1.0])
def test_held_commands_of_a_ramp_come_so_much_later_or_earlier(share):
    ramp = np.r_[np.zeros(3), np.arange(20.0), np.full(3, 19.0)]
    rows = {"time_s": DT_S * np.arange(len(ramp)), "pressure_cmd_kpa": ramp}
    inputs = Inputs.from_samples(rows, switch=np.full(len(ramp), share), start="held")
    np.testing.assert_allclose(inputs.pressure_kpa[6:20, 0], ramp[6:20] - (share - 0.5))
