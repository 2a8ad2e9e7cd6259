"""`pneutac control`: a program that the bench can drive, and what its recording says of it."""

import json

import numpy as np
import pandas as pd
import pytest
from verbs import verb

from lerobot_pneutac import Recording, Twin, control
from lerobot_pneutac.verbs.measure import read_program
from pneutac_datasets.generate.standin import write_program
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Value


@pytest.fixture(scope="module")
def twin():
    twin = Twin.builtin()
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.2), "vent_time_s": Value(0.4)}
    return twin


def test_the_program_goes_from_the_report_to_the_bench_and_back(twin, tmp_path, capsys):
    folder = twin.save(tmp_path / "twin")
    verb("control", twin=folder, bend="loops", out=tmp_path / "out")
    program = tmp_path / "out" / "program.csv"
    (trial,) = read_program(str(program), 15.0, 20.0)
    asked = pd.read_csv(program)
    np.testing.assert_allclose(trial.pressure_kpa[:, 0], asked["pressure_cmd_kpa"])
    write_program(tmp_path / "bench", program)
    verb("control", twin=folder, bend=program, recording=tmp_path / "bench", out=tmp_path / "after")
    assert "The finger followed the bend within" in " ".join(capsys.readouterr().out.split())
    found = json.loads((tmp_path / "after" / "result.json").read_text())
    tip = Recording.load(tmp_path / "bench").samples
    bend = 2 * np.arctan2(tip["tip_z_mm"], tip["tip_x_mm"])
    assert found["error_rad"] == pytest.approx(
        np.sqrt(np.mean((bend - asked["bend_angle_rad"]) ** 2)), rel=1e-3
    )
    assert found["expected_error_rad"] < 0.02 < found["error_rad"]  # nobody calibrated this twin


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("time_s\n0\n1\n", "columns time_s and bend_angle_rad"),
        ("time_s,bend_angle_rad\n0,0.3\n0,0.4\n", "time_s must rise"),
        ("time_s,bend_angle_rad\n0,0.5\n1,inf\n", "finite numbers"),
        ("time_s,bend_angle_rad\n0,0.5\n1,40\n", "this finger reaches"),
    ],
)
def test_a_bend_that_cannot_be_followed_is_refused(twin, tmp_path, table, sentence):
    file = tmp_path / "bend.csv"
    file.write_text(table)
    with pytest.raises(InputError, match=sentence):
        control(twin, file)


def test_other_bad_input_is_refused_in_a_sentence(twin, tmp_path):
    with pytest.raises(InputError, match="bend=square is neither a CSV file nor one of steps, sine, loops"):
        control(twin, "square")
    with pytest.raises(InputError, match="hz is 0; give 1 to 1000"):
        control(twin, hz=0)
    with pytest.raises(InputError, match="'gel'; bend is commanded of a finger"):
        control(Twin(device="gel"))
    program = tmp_path / "program.csv"
    for rows, sentence in (
        ("time_s,pressure_cmd_kpa\n0,1\n0.05,99\n", "in 0 to 15"),
        ("time_s,pressure_cmd_kpa\n0,1\n3,2\n", "must rise, most times by the same and by at most 0.2 s"),
        ("time_s\n0\n", "must be a table"),
    ):
        program.write_text(rows)
        with pytest.raises(InputError, match=sentence):
            write_program(tmp_path / "bench", program)
    assert not (tmp_path / "bench").exists()
