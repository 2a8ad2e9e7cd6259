"""Instants at which commands stepped, found again in recordings that were made with them."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pneutac_sim.finger import BodyData, Pipeline
from pneutac_sim.finger.instants import instants, step_rows
from pneutac_sim.twin import Twin, Value

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


def test_where_the_time_of_sending_is_known_nothing_is_sought(made):
    _, twin, pipeline, theta, recording = made

    def read(share):
        raise AssertionError("nothing needs to be simulated")

    sent = recording.samples.assign(time_sent_s=recording.samples["time_s"])
    assert instants(SimpleNamespace(samples=sent, device="finger"), read, pipeline, theta) is None
    still = recording.samples.assign(pressure_cmd_kpa=np.linspace(0, 5, len(recording.samples)))
    assert instants(SimpleNamespace(samples=still, device="finger"), read, pipeline, theta) is None
