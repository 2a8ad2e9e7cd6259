"""Instants at which commands stepped, found again in recordings that were made with them."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pneutac_sim.finger import BodyData, Pipeline
from pneutac_sim.finger.instants import COST, StepRows, instants, step_rows
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
