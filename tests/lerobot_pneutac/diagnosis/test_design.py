"""What a program is expected to tell: known cases of information, limits, and what was visited."""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.diagnosis.design import choices, nats_between
from lerobot_pneutac.diagnosis.programs import Limits, common_programs, first_program, sent_s, table, visited
from lerobot_pneutac.diagnosis.result import Candidate
from pneutac_datasets.recording.axes import command_columns, device_with
from pneutac_datasets.recording.recording import Recording, joined
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.twin import Twin, Value

LIMITS = Limits(0.0, 15.0, hz=10.0, seconds=120.0)


def recording(folder, t, p, trial=0):
    commands = np.reshape(np.broadcast_to(p, np.shape(t)) if np.ndim(p) == 0 else p, (len(t), -1)).T
    columns = dict(zip(command_columns(len(commands)), commands, strict=True))
    samples = pd.DataFrame({"trial": trial, "time_s": t, **columns, "tip_x_mm": 100.0, "tip_z_mm": 1.0})
    device = device_with(len(commands))
    if device == "arm":
        samples["tip_y_mm"] = 0.0
    return Recording(folder, {"device": device, "length_mm": 110.0}, samples, device)


def twin(**effects):
    made = Twin.builtin()
    made.effects |= {k: {n: Value(x) for n, x in v.items()} for k, v in effects.items()}
    return made


def test_information_between_models_is_what_is_known_of_equal_and_of_far_ones():
    same, far = np.zeros((50, 2)), np.full((50, 2), 9.0)
    assert nats_between([same, same], np.array([0.5, 0.5]), 1.0) == pytest.approx(0.0)
    assert nats_between([same, far], np.array([0.5, 0.5]), 1.0) == pytest.approx(np.log(2))
    p = np.array([0.7, 0.2, 0.1])
    told = [same, far, -far]
    assert nats_between(told, p, 1.0) == pytest.approx(-(p * np.log(p)).sum())
    near = same + 0.05
    assert 0 < nats_between([same, near], np.array([0.5, 0.5]), 1.0) < np.log(2)


def test_the_program_that_shows_a_lag_ranks_before_those_that_hide_it(tmp_path):
    t, p = first_program(LIMITS)
    lagged = twin(valve_lag={"fill_time_s": 0.06, "vent_time_s": 0.06})
    models = [Candidate(lagged, ("valve_lag",), 0.5), Candidate(twin(), (), 0.5)]
    ranked = choices(recording(tmp_path, t, p), models, 0.5, LIMITS)
    told = {c.name: c.rivals for c in ranked}
    assert told["steps to 100%, held 2 s"] > 0.65 > 0.4 > told["strokes to 40% in 15 s"]
    assert all(0 <= c.rivals <= np.log(2) + 1e-9 and 0 <= c.new <= 1 for c in ranked)
    assert [c.worth for c in ranked] == sorted((c.worth for c in ranked), reverse=True)


def test_what_is_planned_is_sent_when_it_is_due(tmp_path):
    """A log that tells when commands were sent says nothing of when those of a new program will be."""
    t, p = first_program(LIMITS)
    driven = recording(tmp_path, t, p)
    driven.samples["time_sent_s"] = np.maximum.accumulate(np.where(np.diff(p[:, 0], prepend=1) != 0, t, 0))
    planned = table(driven, t, p, {})
    assert planned["time_sent_s"].tolist() == sent_s(t, p).tolist()
    assert "time_sent_s" not in table(recording(tmp_path, t, p), t, p, {})


def test_a_wide_interval_is_worth_narrowing_and_a_known_constant_is_not(tmp_path):
    t, p = first_program(LIMITS)

    def gain(half):
        made = twin()
        value = made.parameters["gain_rad_per_kpa"].value
        made.parameters["gain_rad_per_kpa"] = Value(value, (value - half, value + half))
        ranked = choices(recording(tmp_path, t, p), [Candidate(made, (), 1.0)], 0.5, LIMITS)
        return next(c.constants for c in ranked if c.name == "hold at 90%")

    assert gain(1e-9) == pytest.approx(0.0, abs=1e-3)
    assert gain(2e-3) > gain(1e-3) > 0.5


def test_what_was_driven_before_is_not_new(tmp_path):
    def cells(t, p, **conditions):
        driven = recording(tmp_path, t, p)
        driven.samples = driven.samples.assign(**conditions)
        return visited(driven, LIMITS)

    for t, p in [first_program(LIMITS), *((t, p) for *_, t, p in common_programs(LIMITS))]:
        assert p.min() >= 0 and p.max() <= 15.0 and (np.diff(t) > 0).all() and p[0] == 0
        seen = cells(t, p)
        assert sum(seen.values()) == pytest.approx(t[-1] + 0.1)
    slow = {n: (t, p) for n, _, t, p in common_programs(LIMITS)}["strokes to 100% in 15 s"]
    fast = {n: (t, p) for n, _, t, p in common_programs(LIMITS)}["strokes to 100% in 1.5 s"]
    common = set(cells(*slow)) & set(cells(*fast))
    assert len(common) <= 3  # they differ in pace wherever they move
    assert not set(cells(*slow, payload_g=0.0)) & set(cells(*slow, payload_g=20.0))


def test_a_finger_of_vacuum_alone_is_driven_below_zero_and_one_of_both_above(tmp_path):
    for limits, far in ((Limits(-50.0, 0.0), -50.0), (Limits(-20.0, 30.0), 30.0), (Limits(5.0, 15.0), 15.0)):
        t, p = first_program(limits)
        assert p[0] == limits.rest_kpa and max(p, key=lambda x: abs(x - p[0])) == pytest.approx(far)
        assert p.min() >= limits.low_kpa and p.max() <= limits.high_kpa
        levels = {level for _, level, *_ in visited(recording(tmp_path, t, p), limits)}
        assert len(levels) >= 5


def test_limits_that_leave_nothing_are_told(tmp_path):
    t, p = first_program(LIMITS)
    models = [Candidate(twin(), (), 1.0)]
    with pytest.raises(InputError, match="No program fits into the 5 s"):
        choices(recording(tmp_path, t, p), models, 0.5, Limits(0.0, 15.0, seconds=5.0))
    with pytest.raises(InputError, match="No program fits between 3 and 3 kPa"):
        Limits(3.0, 3.0)
    with pytest.raises(InputError, match="No program fits between 0 and 0 kPa in chamber 2"):
        Limits(0.0, (15.0, 0.0, 15.0))
    for huge in ({"hz": 1e9}, {"seconds": 1e9}, {"length_s": 1e9}, {"hz": np.nan}):
        with pytest.raises(InputError, match="up to 1000000 samples, not .* samples a second; give less"):
            Limits(0.0, 15.0, **huge)
    more = recording(tmp_path, t, np.repeat(p, 3, axis=1))
    with pytest.raises(InputError, match="has 3 chambers, and the limits are of 1"):
        choices(more, models, 0.5, LIMITS)


def test_joined_recordings_keep_their_trials_and_how_they_began(tmp_path):
    a = recording(tmp_path / "a", [0.0, 0.1, 0.0, 0.1], 1.0, [4, 4, 7, 7])
    b = recording(tmp_path / "b", [0.0, 0.1], 2.0, [0, 0])
    a.meta["trials"] = {"7": {"start": "continues", "pause_s": 3}}
    b.meta["trials"] = {"0": {"start": "rested"}}
    both = joined([a, b], [None, None])
    assert list(both.samples["trial"]) == [0, 0, 1, 1, 2, 2]
    assert both.meta["trials"] == {"1": {"start": "continues", "pause_s": 3}, "2": {"start": "rested"}}
    assert list(a.samples["trial"]) == [4, 4, 7, 7]
    rested = joined([a, b], [None, 90.0]).meta["trials"]["2"]
    assert rested == {"start": "continues", "pause_s": 90.0}
    b.samples["payload_g"] = 5.0
    with pytest.raises(InputError, match="differ in payload_g"):
        joined([a, b], [None, None])


def arm():
    made = Twin("arm", 110.0)
    pipeline = Pipeline.of(made)
    return pipeline.update(made, pipeline.theta(made, 60.0))


def test_programs_of_three_chambers_press_each_alone_two_all_and_turn():
    limits = Limits(0.0, (30.0, 60.0, 40.0), hz=10.0, length_s=20.0)
    t, p = first_program(limits)
    assert p.shape == (len(t), 3) and not p[0].any() and p[-1] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(p.max(axis=0), [30.0, 60.0, 40.0])
    alone = [(p[:, i] > 1) & (np.delete(p, i, axis=1) < 1e-6).all(axis=1) for i in range(3)]
    assert all(rows.sum() > 20 for rows in alone)
    programs = list(common_programs(limits))
    assert len({name for name, *_ in programs}) == len(programs)
    for *_, p in programs:
        assert (p >= 0).all() and (p <= limits.high_kpa + 1e-9).all() and p[0].max() == 0
    kinds = {kind for _, kind, *_ in common_programs(Limits(0.0, 30.0))}
    assert {kind for _, kind, *_ in programs} == kinds | {"turns"}
    turn = next(p for name, _, _, p in programs if name == "turns at 100% in 12 s") / limits.high_kpa
    way = np.unwrap(np.arctan2(*(turn @ np.array([[0, 1], [0.75**0.5, -0.5], [-(0.75**0.5), -0.5]])).T))
    assert np.ptp(way[20:-20]) > 4 * np.pi and abs(way[-20] - way[20]) < 1.0  # there and back


def test_another_chamber_and_another_beside_it_are_new(tmp_path):
    limits, t = Limits(np.zeros(3), np.full(3, 15.0), hz=10.0), np.arange(0, 10, 0.1)
    stroke = 7 * (1 - np.cos(t))

    def cells(*shares):
        return set(visited(recording(tmp_path, t, stroke[:, None] * np.array(shares)), limits))

    one, other, both = cells(1, 0, 0), cells(0, 1, 0), cells(1, 1, 0)
    assert one == cells(1, 0, 0) and len(one & other) < 0.2 * len(other)
    assert len(both - one - other) > 0.5 * len(both)


def test_the_chamber_in_which_two_models_differ_is_driven(tmp_path):
    limits = Limits(np.zeros(3), (60.0, 60.0, 20.0), hz=10.0, seconds=60.0, length_s=20.0)
    t, p = first_program(limits)
    weaker = arm()
    weaker.parameters["chamber_2_gain"] = Value(0.8 * weaker.parameters["chamber_2_gain"].value)
    models = [Candidate(arm(), (), 0.5), Candidate(weaker, ("weaker",), 0.5)]
    ranked = choices(recording(tmp_path, t, p), models, 0.5, limits)
    told = {c.name: c.rivals for c in ranked}
    assert told["hold at 40%, chamber 2"] > 0.6 and told["hold at 40%, chamber 1"] < 0.01
    assert ranked[0].pressure_kpa[:, 1].max() > 0 and ranked[0].pressure_kpa.shape[1] == 3
    assert max(c.pressure_kpa[:, 2].max() for c in ranked) <= 20.0
    assert ranked[0].predictions[0].shape == (len(ranked[0].time_s), 3)
