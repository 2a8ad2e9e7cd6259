"""What to record next asks for nothing that the recording has."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.study.base import experiment_of, unidentified
from lerobot_pneutac.study.body import BodyStudy, _Judgement
from lerobot_pneutac.study.pair import longer
from lerobot_pneutac.verbs.fit_body import advice, held_kpa, shown_by, unknown_parameters
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.twin import Twin, Value

TWIN = Twin("finger", 100.0, [20.0, 50.0, 80.0])


def recording(levels=5, hold_s=4.0, hz=10.0, top=40.0, **columns) -> Recording:
    """Stairs of so many levels up to `top` kPa, each held; further columns as given."""
    kpa = np.repeat(np.linspace(0, top, levels), round(hold_s * hz))
    samples = {"trial": 0, "time_s": np.arange(len(kpa)) / hz, "pressure_cmd_kpa": kpa}
    bend = 0.01 + 0.02 * kpa
    samples |= {"tip_x_mm": 100 * np.sin(bend) / bend, "tip_z_mm": 100 * (1 - np.cos(bend)) / bend}
    samples |= {name: np.resize(values, len(kpa)) for name, values in columns.items()}
    return Recording("bench", {"device": "finger"}, pd.DataFrame(samples), "finger")


@pytest.mark.parametrize("levels", [3, 9])
def test_holds_are_asked_for_only_where_there_are_few(levels):
    r = recording(levels)
    assert len(held_kpa(r)) == levels
    said = shown_by("rest_pressure_kpa", TWIN, r)
    assert ("record holds" in said) == (levels < 5)
    assert "9 pressures are there" in said if levels == 9 else "has 3 such pressures, from 0 to 40" in said
    tilted = TWIN.copy()
    tilted.effects["base_tilt"] = {"angle_rad": Value(0.1)}
    assert ("two points on the base" in shown_by("rest_pressure_kpa", tilted, r)) == (levels == 9)
    low = recording(9, top=8.0)
    low.samples.loc[len(low) - 1, "pressure_cmd_kpa"] = 40.0
    assert "over the whole range (this recording has 5 such" in shown_by("rest_pressure_kpa", TWIN, low)


def test_a_profile_is_shown_by_what_a_marker_at_the_tip_can_show():
    for name in ("gain_alpha", "gain_rad_per_kpa"):  # which make up for each other at small bends
        said = shown_by(name, TWIN, recording())
        assert said.startswith("the tip's angle (bend_angle_rad) or larger bends show it; the tip is")
    assert "angle" not in shown_by("gain_alpha", TWIN, recording(bend_angle_rad=[0.1, 0.2]))
    assert shown_by("gain_alpha", TWIN, recording(q_1_rad=[0.1])).startswith("record larger bends")
    rows = {n: {"ci95": (-1.5, 1.5), "unit": "", "note": unidentified(said)} for n in ("gain_alpha", "b")}
    told = unknown_parameters(rows)
    assert "near the base; -1.5 to 1.5 fit about as well) and b (-1.5" in told and told.count("larger") == 1


GAUGE = {"pressure_kpa": np.linspace(0, 40, 97)}


@pytest.mark.parametrize(
    ("effect", "has", "lacks", "named"),
    [
        ("gravity", {"gravity_x": [1, -1]}, {"gravity_x": [1, 0.9]}, "opposite directions of gravity"),
        ("payload", {"payload_g": [0, 10, 20]}, {"payload_g": [0, 10]}, "2 masses"),
        ("thermal", {"temperature_c": [21, 29]}, {"temperature_c": [21, 23]}, "from 21 to 29 °C"),
        ("valve_lag", GAUGE, {}, "measured pressure at 10 Hz"),
        ("dead_time", GAUGE | {"hz": 50.0}, GAUGE, "measured pressure at 50 Hz"),
        ("creep", GAUGE | {"hold_s": 130.0, "hz": 1.0}, GAUGE, "a hold of 129 s"),
    ],
)
def test_an_effects_experiment_is_not_proposed_where_it_was_recorded(effect, has, lacks, named):
    flat = {"gravity_y": [0.0], "gravity_z": [0.0]} if effect == "gravity" else {}
    assert named in experiment_of(effect, recording(**has, **flat))
    for given in (lacks, {}):
        assert (
            experiment_of(effect, recording(**given, **(flat if given else {})))
            == get_effect(effect).experiment
        )


def test_a_long_recording_is_not_to_be_made_longer():
    assert longer(recording()).endswith("in several trials (this recording has 20 s).")
    assert longer(recording(10, hold_s=70.0, hz=0.1)).startswith("Record faster: 12 minutes are enough")


def test_the_noise_asks_for_minutes_that_are_missing_alone():
    short = noise_floor(recording(2, hold_s=2.0)).how
    assert "record two minutes or more, run one program twice, or declare" in short
    long = noise_floor(recording(3, hold_s=60.0, hz=0.3)).how
    assert "cannot be determined" in long and "two minutes" not in long


def test_what_is_hung_on_the_tip_is_more_than_hung_there():
    assert "hang about 400 g" in advice(TWIN, recording(payload_g=[0.0, 200.0]))
    assert "hang about 400 g" not in advice(TWIN, recording())


def test_pauses_that_a_memory_goes_on_in_are_asked_for():
    one = recording(9).samples
    runs = pd.concat([one.assign(trial=k) for k in range(3)], ignore_index=True)
    r = Recording("bench", {"device": "finger", "noise": {"tip_x_mm": 0.1, "tip_z_mm": 0.1}}, runs, "finger")
    study, twin = BodyStudy(TWIN, r, 0, []), TWIN.copy()
    weights = {q.name: Value(0.2 * (q.name == "weight_40s")) for q in get_effect("creep").parameters}
    twin.effects["creep"] = weights
    twin.parameters["pause_s"] = Value(9.0)
    found = SimpleNamespace(after=SimpleNamespace(twin=twin), selected=["creep"])
    assert "before 2 runs is not recorded" in " ".join(study.caveats(found))
    assert "under `trials`, how long the device rested" in study.to_log(found)
    stated = {str(k): {"start": "continues", "pause_s": 9} for k in (1, 2)}
    for trials in (stated, {"0": {"start": "rested"}} | stated):  # nothing is before the first run
        r.meta["trials"] = trials
        assert not study.to_log(found) and "rested" not in " ".join(study.caveats(found))


@pytest.mark.parametrize("time_s", [30.0, 300.0])
def test_a_drift_slower_than_the_recording_is_not_known_on_another_day(time_s):
    twin = TWIN.copy()
    twin.effects["p exp(-t)"] = {"time_s": Value(time_s)}
    judged = _Judgement.__new__(_Judgement)
    judged.study, judged.after = (
        SimpleNamespace(recording=recording(9)),
        SimpleNamespace(twin=twin, effects=[]),
    )
    assert ("the device drifts over 300 s, longer than" in judged.unseen()) == (time_s == 300.0)
