"""`pneutac check`: what later verbs would refuse, all of it, of whatever a folder holds."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from demonstration_sets import write_demonstrations
from sensors import wide_twin
from verbs import refused, verb

from lerobot_pneutac.verbs.check import check_path
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.features import STATE_NAMES
from pneutac_sim.twin import Twin, Value

GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"


def test_good_demonstrations_pass_and_recorded_ones_too(tmp_path):
    assert Recorded(write_demonstrations(tmp_path / "d")).faults(Twin.builtin()) == []
    assert check_path(GOLDEN / "demos").kind == "demonstrations"
    assert check_path(GOLDEN / "demos").faults == []


@pytest.mark.parametrize("left", ["history/001/twin.yaml", "arrays.safetensors", "action.safetensors"])
def test_a_twin_without_its_file_is_no_recording(tmp_path, left):
    (file := tmp_path / "twin" / left).parent.mkdir(parents=True)
    file.touch()
    found = check_path(tmp_path / "twin")
    assert found.kind == "twin" and "twin.yaml" in found.faults[0]
    with pytest.raises(InputError, match="twin.yaml; (copy|restore)"):
        Twin.load(tmp_path / "twin")


def test_all_faults_of_demonstrations_are_told_at_once(tmp_path):
    names = ["joint_1.pose" if n == "joint_1.pos" else n for n in STATE_NAMES]
    spoilt = write_demonstrations(tmp_path / "a", names=names, fps=30)
    text = " ".join(Recorded(spoilt).faults(Twin.builtin()))
    assert "30 fps, but the station's control rate is 15 Hz" in text
    assert "lacks 'joint_1.pos' (there is 'joint_1.pose')" in text
    spoilt = write_demonstrations(tmp_path / "b", (12.0, 40.0, 12.0, np.nan), (0.1, 0.1, 0.0, 0.1))
    text = " ".join(Recorded(spoilt).faults(Twin.builtin()))
    assert "Episode 1 commands pressures beyond the 0 to 15 kPa" in text
    assert "Episode 3 holds numbers that are not finite" in text
    twin = wide_twin()
    twin.pressure_range_kpa = (0.0, 60.0)
    text = " ".join(Recorded(spoilt).faults(twin))
    assert "beyond" not in text and "(320, 240, 3) and those of the twin's sensor (480, 640, 3)" in text


def test_demonstrations_of_another_robot_are_called_so_first(tmp_path):
    names = ["shoulder_pan.pos" if n == "joint_1.pos" else n for n in STATE_NAMES]
    root = write_demonstrations(tmp_path / "a", names=names)
    info = json.loads((root / "meta" / "info.json").read_text())
    (root / "meta" / "info.json").write_text(json.dumps(info | {"robot_type": "so101_follower"}))
    first, *others = Recorded(root).faults(Twin.builtin())
    assert "robot_type is 'so101_follower'; give demonstrations of a 'pneutac' robot." in first and others


def test_a_table_is_judged_by_the_digits_that_its_conversion_has(tmp_path):
    """Metres times 1000 have digits that stored millimetres lack, by which a marker's shifts were counted."""
    seconds, bend = np.arange(0, 60, 0.1), 0.5 - 0.48 * np.cos(np.arange(0, 60, 0.1))
    metres = np.round(90 * (1 - np.cos(bend)) / bend / 1000, 4)
    rows = [f"{t:.1f};{100 * b:.1f};{z}" for t, b, z in zip(seconds, bend, metres, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t;p_soll [mbar];z [m]", *rows]))
    understood = check_path(tmp_path / "log.csv").understood
    assert understood is not None
    before = understood.recording.as_written().samples
    pd.testing.assert_frame_equal(
        before, understood.write(tmp_path / "log.recording").samples, check_exact=True
    )
    assert (before["tip_z_mm"] != understood.recording.samples["tip_z_mm"]).any()


def test_two_rows_are_too_few_to_name_a_unit(tmp_path):
    (tmp_path / "log.csv").write_text("t;p_soll [kPa];x [mm];z [mm]\n0;0;90;0\n0.1;1;89;1\n")
    found = check_path(tmp_path / "log.csv")
    assert found.faults and "can only be" not in " ".join(found.notes)


def test_a_folder_of_folders_names_those_that_can_be_looked_at(tmp_path):
    shutil.copytree(GOLDEN / "finger_creep", tmp_path / "bench")
    Twin.builtin().save(tmp_path / "finger")
    with pytest.raises(InputError, match="give one of them: bench, finger"):
        check_path(tmp_path)


def test_a_table_with_a_repeated_stamp_is_checked_without_it(tmp_path):
    time = np.r_[np.arange(0, 60, 0.1)[:300], np.arange(0, 60, 0.1)[299:]]
    bar = 0.2 - 0.2 * np.cos(time)
    rows = [f"{t:.1f};{p:.4f};{100 - 30 * p:.3f};{40 * p:.3f}" for t, p in zip(time, bar, strict=True)]
    text = "\r\n".join(["t;p_soll [bar];x [mm];z [mm]", *rows]).replace(".", ",")
    (tmp_path / "log.csv").write_text(text)
    found = check_path(tmp_path / "log.csv")
    assert found.faults == [] and len(found.understood.recording) == 600
    assert "column 't', row 301 (line 302 of the file) repeats the stamp 29.9 s" in found.understood.notes[0]
    assert not any("even clock" in note for note in found.notes)


def test_a_twin_says_what_the_world_will_ask_for(tmp_path):
    twin = Twin.builtin()
    twin.effects["payload"] = get_effect("payload").start()
    twin.parameters["youngs_modulus_mpa"] = Value(40.0)
    twin.save(tmp_path / "twin")
    found = check_path(tmp_path / "twin")
    assert found.kind == "twin" and found.faults == []
    notes = " ".join(found.notes)
    assert "payload_g" in notes and "--env.fidelity=probe works without" in notes
    file = tmp_path / "twin" / "twin.yaml"
    file.write_text(file.read_text().replace("  payload:", "  paylod:"))
    assert "paylod" in check_path(tmp_path / "twin").faults[0]
    assert "payload" in check_path(tmp_path / "twin").faults[0].replace("paylod", "")


def test_all_faults_of_a_twin_are_told_at_once(tmp_path):
    file = Twin.builtin().save(tmp_path) / "twin.yaml"
    text = file.read_text().replace("length_mm: 110.0", "length_mm: long").replace("history: []", "")
    text = text.replace("value: 0.0313", "value: .nan").replace("value: 0.2974", "valeu: 0.2974")
    file.write_text(text.replace("effects: {}", "effects:\n  creep: 3\n  dead_time:\n    delay_s: much"))
    told = " ".join(check_path(tmp_path).faults)
    for said in (
        "field 'length_mm' is malformed",
        "field 'history' is missing",
        "'parameters.gain_alpha' is {'value': nan}; its numbers must be finite",
        "'parameters.gain_beta' is {'valeu': 0.2974}; it must hold 'value'",
        "field 'effects.creep' is 3",
        "field 'effects.dead_time.delay_s' is 'much'",
    ):
        assert said in told
    assert len(check_path(tmp_path).faults) == 6


def test_every_effect_that_does_not_fit_is_told_and_the_gel_too(tmp_path):
    twin = wide_twin()
    twin.effects |= {"creeep": {}, "creep": {"size": Value(1.0)}, "rest_colour": {"exponent_red": Value(1.0)}}
    twin.gel["decay"] = twin.gel.pop("decay_mm")
    told = check_path(twin.save(tmp_path)).faults
    assert len(told) == 4 and all("twin.yaml" in fault for fault in told)
    for said in ("'creeep'; did you mean 'creep'", "'creep'", "rest_colour", "unknown field 'decay'"):
        assert any(said in fault for fault in told)


def test_the_command_tells_each_folder_and_ends_with_one_where_there_is_a_fault(tmp_path, capsys):
    shutil.copytree(GOLDEN / "finger_creep", tmp_path / "bench")
    verb("check", str(tmp_path / "bench"))
    assert "(bench recording): good" in capsys.readouterr().out
    with pytest.raises(SystemExit) as stopped:
        verb("check", str(tmp_path / "bench"), str(write_demonstrations(tmp_path / "d", (20.0, 9.0))))
    assert stopped.value.code == 1
    assert "problem: Episode 0 commands pressures beyond" in " ".join(capsys.readouterr().out.split())
    refused("is 'bench' meant", "check", str(tmp_path / "bensh"))
    (tmp_path / "notes.md").touch()
    with pytest.raises(
        InputError, match="notes.md is none of .csv, .*; give a table or a recording's folder"
    ):
        verb("check", str(tmp_path / "notes.md"))
    refused("There is no option --twins=x", "check", "bench", twins="x")
    refused("A path stands alone: `pneutac check monday.csv`", "check", recording="monday.csv")


def test_a_station_tells_which_tasks_its_arm_does_not_reach(tmp_path):
    file = tmp_path / "station.yaml"
    file.write_text("format: pneutac-station/1\narm: so101\n")
    assert check_path(file).faults == check_path(file).notes == []
    file.write_text("format: pneutac-station/1\narm: so101\nbase_m: [0.0, 0.0, 0.2]\n")
    found = check_path(file)
    assert found.kind == "station" and not found.faults
    assert len(found.notes) == 6 and "short of where the task 'switch' starts" in found.notes[0]
    file.write_text(
        "format: pneutac-station/2\nbase: [0, 0]\nmount_mm: 900\nlatency_s: soon\n"
        "workspace_low_m: [0.3, 0.2]\nworkspace_high_m: 3\n"
        "arm: {urdf: mine.urdf, flange: tool0, home_rad: [0, 0, 0, 0, 0, 0]}\n"
    )
    told = check_path(file).faults
    assert len(told) == 7
    named = ["'base'; did you mean 'base_m'", *"'format' mount_mm latency_s _low_m _high_m mine.urdf".split()]
    assert all(any(name in fault for fault in told) for name in named)
    corners = "workspace_low_m: [0.7, 0, 0.2]\nworkspace_high_m: [0.8, 0.1, 0.5]\n"  # beyond the default's
    file.write_text(f"format: pneutac-station/1\n{corners}")
    assert check_path(file).faults == []
    file.write_text("format: pneutac-station/1\narm: so102\n")
    assert "arm is 'so102'" in check_path(file).faults[0]
