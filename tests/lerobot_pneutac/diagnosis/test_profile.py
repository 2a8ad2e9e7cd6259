"""Profile likelihood on recordings that the model itself made, so that every parameter is known."""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.diagnosis.engine import Engine, StageFitter
from lerobot_pneutac.diagnosis.experiment import predict
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.profile import Profile, profile
from lerobot_pneutac.diagnosis.steps import Steps
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.confidence import Z95
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin, Value

HZ = 10.0
NOISE_MM = 0.3
CREEP = dict.fromkeys(("weight_0_4s", "weight_4s", "weight_40s", "weight_130s"), 0.0)
CREEP |= {"weight_1_3s": 0.1, "weight_13s": 0.15}
LAG = {"fill_time_s": 0.4, "vent_time_s": 0.8}


def record(pressures, effects, seed):
    """What a finger with these effects does in trials of commanded pressure, seen with white noise."""
    p = np.concatenate(pressures)
    table = pd.DataFrame(
        {
            "trial": np.repeat(np.arange(len(pressures)), [len(x) for x in pressures]),
            "time_s": np.concatenate([np.arange(len(x)) / HZ for x in pressures]),
            "program": "made",
            "pressure_cmd_kpa": p,
            "tip_x_mm": 0.0,
            "tip_z_mm": 0.0,
        }
    )
    recording = Recording(None, {"length_mm": 110.0}, table, "finger")
    plain = {"gain_rad_per_kpa": 0.004, "gain_alpha": 0.1, "gain_beta": 0.05, "rest_pressure_kpa": 3.0}
    twin = Twin(parameters={k: Value(v) for k, v in plain.items()})
    twin.effects = {e: {k: Value(v) for k, v in values.items()} for e, values in effects.items()}
    tip = predict(twin, BodyData.of(recording, twin, source="command"))[0]
    noise = NOISE_MM * np.random.default_rng(seed).normal(size=tip.shape)
    table[["tip_x_mm", "tip_z_mm"]] = tip + noise
    return recording


def steps_and_ramps(seed):
    rng = np.random.default_rng(seed)
    knots = [rng.uniform(0, 50, 12) for _ in range(6)]
    steps = [np.repeat(k, 60) for k in knots[:3]]
    t = np.linspace(0, 11, 720)
    return steps + [np.interp(t, np.arange(12), k) for k in knots[3:]]


def profiles(recording, effects, selected=None) -> dict[str, Profile]:
    parts = deal(recording, 0)
    with Engine(recording, parts.train) as engine:
        fitter = StageFitter(engine, Twin(), "pose", "command")
        fit = fitter.fit_all([effects])[0]
        found = profile(fitter, fit, selected or list(effects), parts, Steps())
    return {p.name: p for p in found}, fit


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_interval_holds_the_true_creep_and_lag(seed):
    recording = record(steps_and_ramps(seed), {"creep": CREEP, "valve_lag": LAG}, seed)
    found, _ = profiles(recording, ("creep", "valve_lag"))
    truth = {f"creep.{k}": v for k, v in CREEP.items()} | {f"valve_lag.{k}": v for k, v in LAG.items()}
    assert set(found) == set(truth)
    for name, true in truth.items():
        p = found[name]
        assert p.interval[0] <= p.value <= p.interval[1]
        if true > 0:  # of those that are not there, some intervals start above zero, as one in forty may
            assert p.interval[0] <= true <= p.interval[1], name
            assert p.below and p.above and p.remark == "" and p.interval[1] - p.interval[0] < true, name


def test_the_interval_has_its_coverage():
    inside = []
    for seed in range(12):
        recording = record(steps_and_ramps(seed), {"valve_lag": LAG}, seed)
        found, _ = profiles(recording, ("valve_lag",))
        inside += [p.interval[0] <= LAG[k.partition(".")[2]] <= p.interval[1] for k, p in found.items()]
    assert sum(inside) >= 20  # of 24; fewer than 20 happen once in 150 where each holds with 95 %


def test_a_nearly_linear_parameter_has_the_interval_of_its_jacobian():
    recording = record(steps_and_ramps(5), {"valve_lag": LAG}, 5)
    found, fit = profiles(recording, ("valve_lag",))
    for k, value in fit.twin.effects["valve_lag"].items():
        np.testing.assert_allclose(found[f"valve_lag.{k}"].interval, value.ci95, rtol=0.03)


def test_the_end_of_an_interval_loses_chi_square_of_the_limit():
    recording = record(steps_and_ramps(1), {"creep": CREEP, "valve_lag": LAG}, 1)
    for p in profiles(recording, ("creep", "valve_lag"))[0].values():
        values, chi2 = np.array(p.points).T
        assert chi2.min() == 0.0
        for end, bounded in zip(p.interval, (p.below, p.above), strict=True):
            if bounded:
                side = (values - p.value) * (end - p.value) >= 0
                order = np.argsort(np.abs(values[side] - p.value))
                at = np.interp(
                    abs(end - p.value), np.abs(values[side] - p.value)[order], np.sqrt(chi2[side][order])
                )
                assert at == pytest.approx(Z95, rel=0.05)


def test_what_constant_rate_cannot_tell_is_reported_unbounded():
    # the pressure only ever rises at one rate: nothing vents, and a quick valve is only a shift in time of
    # 0.03 s x 5 kPa/s, far below what the noise lets through; a slow one would show
    recording = record([np.linspace(0, 40, 80)] * 12, {"valve_lag": LAG | {"fill_time_s": 0.03}}, 7)
    found, _ = profiles(recording, ("valve_lag",))
    vent, fill = found["valve_lag.vent_time_s"], found["valve_lag.fill_time_s"]
    assert not vent.below and not vent.above and vent.interval == pytest.approx((0.02, 3.0))
    assert vent.remark == "not bounded below or above by this data"
    assert not fill.below and fill.above and fill.interval[0] == pytest.approx(0.02)
    assert 0.03 < fill.interval[1] < 0.5 and fill.remark == "not bounded below by this data"


def test_only_what_was_selected_is_profiled_and_the_fit_stays_as_it_is():
    recording = record(steps_and_ramps(1), {"creep": CREEP, "valve_lag": LAG}, 1)
    found, fit = profiles(recording, ("creep", "valve_lag"), ["valve_lag"])
    assert set(found) == {"valve_lag.fill_time_s", "valve_lag.vent_time_s"}
    assert all(p.value == fit.twin.effects["valve_lag"][k.partition(".")[2]].value for k, p in found.items())
