"""Pressure programs of `pneutac measure`: built-in ones, tables, and what a diagnosis proposes."""

import json

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.diagnosis.law_programs import law_programs
from lerobot_pneutac.diagnosis.programs import menu
from lerobot_pneutac.verbs.measure import program_chambers, read_program
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError


def test_built_in_programs_cover_the_range_and_start_and_end_at_zero():
    trials = read_program("all", 12.0, 15.0)
    assert {t.program for t in trials} == {"steps", "ramps", "holds", "loops"}
    for t in trials:
        assert t.pressure_kpa[[0, -1]].max() < 0.02 * 12 and t.pressure_kpa.min() >= 0
        np.testing.assert_allclose(np.diff(t.time_s), 1 / 15)
    assert max(t.pressure_kpa.max() for t in trials) == pytest.approx(12.0)
    slopes = [np.gradient(t.pressure_kpa[:, 0], t.time_s).max() for t in trials if t.program == "ramps"]
    np.testing.assert_allclose(slopes, [6.0, 3.0, 1.5], rtol=0.05)


def test_a_table_is_held_from_row_to_row(tmp_path):
    file = tmp_path / "mine.csv"
    file.write_text("time_s,pressure_cmd_kpa\n5,0\n6,8\n7,8\n")
    (trial,) = read_program(str(file), 10.0, 10.0)
    np.testing.assert_allclose(trial.pressure_kpa[:, 0], [0] * 10 + [8] * 11)
    assert trial.program == "mine"


def test_a_table_s_command_is_sent_when_it_says_and_read_at_the_next_sample(tmp_path):
    file = tmp_path / "between.csv"
    file.write_text("time_s,pressure_cmd_kpa\n0,0\n0.23,8\n0.5,8\n")
    (trial,) = read_program(str(file), 10.0, 10.0)
    np.testing.assert_allclose(trial.pressure_kpa[:, 0], [0, 0, 0, 8, 8, 8])
    np.testing.assert_allclose(trial.sent_s, [0, 0.1, 0.2, 0.23, 0.4, 0.5])


def test_a_table_says_what_a_hand_is_to_change(tmp_path):
    file = tmp_path / "hung.csv"
    file.write_text("time_s,pressure_cmd_kpa,payload_g,note\n0,0,20,a\n1,8,20,a\n")
    (trial,) = read_program(str(file), 10.0, 10.0)
    assert trial.conditions == {"payload_g": 20.0}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s\n0\n", "'pressure_cmd_kpa' is missing"),
        ("time_s,pressure_cmd_kpa\n0,1\n1,x\n", "no finite number in row 2"),
        ("time_s,pressure_cmd_kpa\n1,1\n0,1\n", "must rise"),
        (
            "time_s,pressure_cmd_kpa,payload_g\n0,1,heavy\n1,1,2\n",
            "'payload_g' has no finite number in row 1",
        ),
        ("time_s,pressure_cmd_kpa\n0,1\n1,60\n", "max_kpa allow 0 to 15"),
    ],
)
def test_a_bad_table_is_named(tmp_path, text, said):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_program(str(tmp_path / "bad.csv"), 15.0, 15.0)


def test_the_experiment_that_a_diagnosis_proposes_can_be_driven(tmp_path):
    time_s = np.arange(100) / 10
    samples = pd.DataFrame({"trial": 0, "time_s": time_s, "pressure_cmd_kpa": 5 + 5 * np.sin(time_s)})
    samples["tip_z_mm"] = samples["tip_x_mm"] = samples["pressure_cmd_kpa"]
    folder = Recording(tmp_path, {"length_mm": 110.0}, samples, "finger").write(tmp_path / "r")
    hold = next(p for p in menu(Recording.load(folder)) if p.name == "long hold")
    result = tmp_path / "result.json"
    result.write_text(json.dumps({"next_experiment": f"To tell creep from leak: {hold.advice}"}))
    (trial,) = read_program(str(result), 15.0, 15.0, folder)
    assert trial.program == "long hold"
    assert trial.pressure_kpa[(trial.time_s > 1) & (trial.time_s < 79)].std() == pytest.approx(0, abs=1e-9)
    (warmed,) = law_programs(Recording.load(folder), worn := {"p lag(|dp/dt|)": {"time_s": 20.0}})
    constants = {law: {k: {"value": v} for k, v in found.items()} for law, found in worn.items()}
    older = warmed.advice.replace("by as much at both", "alike about both")
    assert older != warmed.advice
    result.write_text(json.dumps({"next_experiment": f"To confirm it: {older}", "parameters": constants}))
    assert read_program(str(result), 15.0, 15.0, folder)[0].program == "for p lag(|dp/dt|)"
    result.write_text(json.dumps({"next_experiment": "Hang weights on it."}))
    with pytest.raises(InputError, match="Hang weights"):
        read_program(str(result), 15.0, 15.0, folder)


def test_vacuum_is_driven_where_it_is_allowed(tmp_path):
    file = tmp_path / "suck.csv"
    file.write_text("time_s,pressure_cmd_kpa\n0,0\n1,-30\n2,0\n")
    with pytest.raises(InputError, match="goes from -30 to 0 kPa; --min_kpa and --max_kpa allow 0 to 15"):
        read_program(str(file), 15.0, 10.0)
    (trial,) = read_program(str(file), 15.0, 10.0, min_kpa=-30.0)
    assert trial.pressure_kpa.min() == -30.0


def test_of_three_chambers_each_is_driven_alone_to_its_own_top_and_loops_turn():
    top = (10.0, 20.0, 30.0)
    holds = read_program("holds", top, 15.0, chambers=3)
    assert len(holds) == 3 * len(read_program("holds", 10.0, 15.0))
    assert all((t.pressure_kpa.max(axis=0) > 0).sum() == 1 for t in holds)
    np.testing.assert_allclose(np.max([t.pressure_kpa.max(axis=0) for t in holds], axis=0), top)
    loops = read_program("loops", top, 15.0, chambers=3)
    turns = [t for t in loops if (t.pressure_kpa.max(axis=0) > 0).all()]
    assert len(turns) == 2
    for t in turns:
        np.testing.assert_allclose(t.pressure_kpa[[0, -1]], 0.0, atol=1e-9)
        assert (t.pressure_kpa >= 0).all() and (t.pressure_kpa <= top).all()


@pytest.mark.parametrize(
    ("columns", "chambers", "said"),
    [
        ("pressure_cmd_1_kpa,pressure_cmd_2_kpa", 3, "commands 2 chambers .* of the 3 that are driven; give"),
        ("pressure_cmd_kpa", 3, "commands 1 chamber .* of the 3 that are driven"),
        ("pressure_cmd_kpa,pressure_cmd_1_kpa", 1, "pressure_cmd_1_kpa too, and 1 chamber is driven"),
        ("pressure_cmd_1_kpa,pressure_cmd_2_kpa,pressure_cmd_3_kpa", 3, "from 0 to 9 kPa in chamber 2"),
    ],
)
def test_a_table_of_other_chambers_is_named(tmp_path, columns, chambers, said):
    count = columns.count("pressure")
    rows = [f"{t},{','.join([str(p)] * count)}" for t, p in ((0, 0), (1, 9))]
    (tmp_path / "bad.csv").write_text("\n".join([f"time_s,{columns}", *rows]) + "\n")
    limits = (15.0, 5.0, 15.0) if chambers == 3 else 15.0
    with pytest.raises(InputError, match=said):
        read_program(str(tmp_path / "bad.csv"), limits, 15.0, chambers=chambers)


def test_limits_of_another_number_of_chambers_are_named():
    with pytest.raises(InputError, match="max_kpa has 2 numbers for 3 chambers; give one for all"):
        read_program("steps", (15.0, 15.0), 15.0, chambers=3)


def test_what_the_diagnosis_of_an_arm_proposes_says_which_chamber_and_drives_it(tmp_path):
    time_s = np.arange(100) / 10
    samples = pd.DataFrame({"trial": 0, "time_s": time_s})
    for i in range(3):
        samples[f"pressure_cmd_{i + 1}_kpa"] = 5 + 5 * np.sin(time_s + i)
    samples["tip_x_mm"] = samples["tip_y_mm"] = samples["tip_z_mm"] = samples["pressure_cmd_1_kpa"]
    folder = Recording(tmp_path, {"length_mm": 110.0}, samples, "arm").write(tmp_path / "r")
    hold = next(p for p in menu(Recording.load(folder)) if p.name == "long hold")
    assert "Do so in chamber 1, while the others stay at" in hold.advice
    result = tmp_path / "result.json"
    result.write_text(json.dumps({"next_experiment": f"To tell creep from leak: {hold.advice}"}))
    (trial,) = read_program(str(result), 15.0, 15.0, folder, chambers=3)
    assert trial.pressure_kpa.shape[1] == 3 and np.ptp(trial.pressure_kpa, axis=0)[1:].max() == 0
    assert np.ptp(trial.pressure_kpa[:, 0]) > 5 and program_chambers(str(result), folder) == 3
    with pytest.raises(InputError, match="r has 3 chambers, and 1 would be driven; give the bench"):
        read_program(str(result), 15.0, 15.0, folder)
