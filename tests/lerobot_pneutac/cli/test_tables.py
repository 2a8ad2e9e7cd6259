"""A lab's own table at the command line: shown once, confirmed, kept beside it, checked."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.cli import _dispatch
from pneutac_datasets.recording.recording import Recording

COLUMNS = {
    "trial": "Lauf",
    "program": "Programm",
    "time_s": "Zeit [s]",
    "pressure_cmd_kpa": "p_soll [bar]",
    "tip_x_mm": "x",
    "tip_y_mm": "y",
    "tip_z_mm": "z",
    "temperature_c": "Temp",
    "payload_g": "Gewicht [g]",
    "gravity_x": "gx",
    "gravity_y": "gy",
    "gravity_z": "gz",
}


def bench():
    """Three runs of a finger of 73 mm, by a recording's names, with the digits that CSV keeps."""
    parts = []
    for run, (program, warm, load) in enumerate(
        (("stairs", 21.4, 0), ("warm", 39.1, 0), ("payload", 21.4, 2.7))
    ):
        t = np.round(np.arange(0, 20, 0.05), 2)
        p = np.round(np.clip(12 * np.floor(t / 4), 0, 48), 3)
        z = np.round(0.6 * p + 0.05 * np.sin(7 * t + run), 3)
        x = np.round(np.sqrt(73.0**2 - z**2), 3)
        parts.append(
            pd.DataFrame(
                {"trial": run + 1, "program": program, "time_s": t, "pressure_cmd_kpa": p, "tip_x_mm": x}
            )
            .assign(tip_y_mm=0.1, tip_z_mm=z, temperature_c=warm, payload_g=load)
            .assign(gravity_x=0.0, gravity_y=0.0, gravity_z=-1.0)
        )
    return pd.concat(parts, ignore_index=True)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """`lab.csv` of German names, semicolons, decimal commas, bar and metres, and one file a run."""
    monkeypatch.chdir(tmp_path)
    table = bench()
    table["pressure_cmd_kpa"] = (table["pressure_cmd_kpa"] / 100).round(6)
    for a in "xyz":
        table[f"tip_{a}_mm"] = (table[f"tip_{a}_mm"] / 1000).round(6)
    table = table.rename(columns=COLUMNS)
    table.to_csv("lab.csv", sep=";", decimal=",", index=False)
    (tmp_path / "runs").mkdir()
    for run, rows in table.groupby("Lauf"):
        rows.to_csv(f"runs/lauf_{run}.csv", sep=";", decimal=",", index=False)
    monkeypatch.setattr(sys, "stdin", open("/dev/null"))
    return tmp_path


@pytest.mark.parametrize(("given", "kept"), [("lab.csv", "lab"), ("runs/*.csv", "runs/lauf_1_to_lauf_3")])
def test_one_command_goes_from_a_table_to_a_twin(folder, capsys, given, kept):
    with pytest.raises(SystemExit, match="Add --yes if this is right"):
        _dispatch(["new", "--twin=twin", f"--recording={given}"])
    assert not (folder / "twin").exists()
    capsys.readouterr()
    _dispatch(["new", "--twin=twin", f"--recording={given}", "--yes"])
    said = capsys.readouterr().out
    shown = said.partition("Stored in")[0]
    assert "3 runs, 59.8 s, 20 Hz (semicolons, decimal commas)" in shown and "length 73 mm" in shown
    assert len(shown.split()) <= 80
    recording = Recording.load(f"{kept}.recording")
    pd.testing.assert_frame_equal(
        recording.samples[list(COLUMNS)], bench()[list(COLUMNS)], check_dtype=False, rtol=0, atol=1e-12
    )
    _dispatch(["compare", "--twin=twin", f"--recording={given}"])
    assert "Lauf" not in capsys.readouterr().out  # shown once
    _dispatch(["check", given])
    assert "good" in capsys.readouterr().out


def test_a_changed_table_is_converted_again_by_its_mapping(folder, capsys):
    _dispatch(["convert", "lab.csv"])
    meta = json.loads((folder / "lab.recording" / "recording.json").read_text())
    (folder / "lab.recording" / "recording.json").write_text(
        json.dumps(meta | {"noise": {}, "notes": "mine"})
    )
    lines = (folder / "lab.csv").read_text().splitlines()
    (folder / "lab.csv").write_text("\n".join(lines[:-10]) + "\n")
    capsys.readouterr()
    _dispatch(["new", "--twin=twin", "--recording=lab.csv"])
    assert "Stored in lab.recording, by lab.recording/mapping.yaml" in capsys.readouterr().out
    recording = Recording.load("lab.recording")
    assert len(recording) == len(lines) - 11 and recording.meta["notes"] == "mine"
    (folder / "other.csv").write_text("\n".join(lines[:-20]) + "\n")
    _dispatch(["compare", "--twin=twin", "--recording=other.csv", "--mapping=lab.recording/mapping.yaml"])
    (folder / "theirs.recording").mkdir()
    (folder / "theirs.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(SystemExit, match="theirs.recording exists and is no earlier conversion"):
        _dispatch(["new", "--twin=t2", "--recording=theirs.csv", "--yes"])


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("new --twin=t --recording=lab.xlsx", "There is no file 'lab.xlsx'"),
        ("new --twin=t --recording=lbb.csv", "There is no file 'lbb.csv'; there is lab.csv."),
        ("new --twin=t --recording=none/*.csv", "There is no file 'none/\\*.csv'"),
        (
            "convert lab.csv --columns={p_soll[bar]:pressure_cmd_kpa}",
            "has no column 'p_soll\\[bar\\]'; it has",
        ),
        ("convert lab.csv --columns=[", "columns is '\\[', which names no column"),
        ("convert lab.csv --base=1,2", "--base is '1,2'; of a table give three mm"),
        ("convert lab.csv --base_x=z --base_z=z", "--base_x is 'z' and base_z 'z'; give two different"),
        ("convert lab.csv --mapping=lab.csv", "no mapping|not valid YAML|field|is none of"),
        (
            "calibrate --twin=t --recording=lab.csv --mapping=none.yaml",
            "--mapping is 'none.yaml', which is no file",
        ),
        ("convert runs --out=x", "is no ROS 2 bag|is missing"),
    ],
)
def test_what_is_wrong_is_one_sentence(folder, line, says):
    with pytest.raises(SystemExit, match=says) as e:
        _dispatch(line.split())
    assert str(e.value).count("\n") == 0
    assert not (folder / "t").exists()


def test_check_tells_what_is_open_in_a_table(folder, capsys):
    (folder / "open.csv").write_text("t,p,x,z\n0,0,70,0\n0.1,1,69,5\n0.2,2,68,9\n")
    with pytest.raises(SystemExit):
        _dispatch(["check", "open.csv"])
    assert "'p' (0 to 2) has no unit" in " ".join(capsys.readouterr().out.split())
