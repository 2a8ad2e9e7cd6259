"""`python -m pneutac_datasets.generate`: every device, what is hidden, and options that belong to another."""

import json

import pandas as pd
import pytest

from pneutac_datasets.generate.__main__ import main
from pneutac_datasets.recording.recording import Recording


def test_a_finger_and_where_its_truth_is(tmp_path, capsys):
    out = tmp_path / "r"
    assert main(["--effect=leak", f"--out={out}", "--seed=1", "--minutes=2", "--no-measured-pressure"]) == 0
    printed = capsys.readouterr().out
    assert printed == f"recording: {out}\ntruth: {tmp_path / 'truth' / 'r.json'}\n"
    assert "pressure_kpa" not in pd.read_csv(out / "samples.csv")
    assert json.loads((tmp_path / "truth" / "r.json").read_text())["effects"] == ["leak"]


def test_a_gel_and_where_its_truth_is(tmp_path, capsys):
    out = tmp_path / "g"
    assert main(["--device=gel", "--effect=shadow", f"--out={out}", "--images=2"]) == 0
    assert f"truth: {tmp_path / 'truth' / 'g.json'}" in capsys.readouterr().out
    assert list(json.loads((tmp_path / "truth" / "g.json").read_text())) == ["shadow"]
    assert len(Recording.load(out)) == 2
    assert main(["--device=gel", f"--out={tmp_path / 'one'}", "--images=1"]) == 1
    assert "images is 1; at least 2" in capsys.readouterr().err


def test_the_standin_is_two_recordings(tmp_path, capsys):
    assert main(["--device=standin", f"--out={tmp_path}", "--minutes=1"]) == 0
    assert capsys.readouterr().out == f"finger: {tmp_path / 'finger'}\ngel: {tmp_path / 'gel'}\n"
    assert main(["--device=standin", f"--out={tmp_path / 'none'}", "--minutes=0"]) == 1
    assert "minutes must be 1 to 60" in capsys.readouterr().err


def test_photographs_take_body_and_particles(tmp_path, monkeypatch, capsys):
    import pneutac_datasets.generate.photographs as photographs

    calls = []
    monkeypatch.setattr(photographs, "write_photographs", lambda *a, **k: calls.append((a, k)))
    assert main(["--device=photographs", f"--out={tmp_path / 'p'}", "--seed=3", "--body=arm"]) == 0
    assert calls == [((tmp_path / "p", 3, "arm"), {})]
    assert f"truth: {tmp_path / 'truth' / 'p.json'}" in capsys.readouterr().out


def test_a_recording_that_is_there_is_not_overwritten(tmp_path, capsys):
    out = tmp_path / "r"
    out.mkdir()
    (out / "samples.csv").write_text("mine")
    assert main([f"--out={out}", "--minutes=1"]) == 1
    assert capsys.readouterr().err == f"{out} exists already; delete it or give another --out.\n"
    assert (out / "samples.csv").read_text() == "mine" and not (tmp_path / "truth").exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--effect=ghost"], "There is no hidden effect 'ghost'; there are none, "),
        (["--device=gel", "--effect=ghost"], "'ghost' is no optics effect; give one of "),
        (
            ["--device=gel", "--minutes=2"],
            "--minutes is not for --device=gel, which takes --effect",
        ),
        (
            ["--device=standin", "--no-measured-pressure"],
            "--no-measured-pressure is not for",
        ),
    ],
)
def test_bad_options_are_one_sentence(tmp_path, capsys, options, sentence):
    assert main([*options, f"--out={tmp_path / 'r'}"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(sentence) and error.count("\n") == 1
    assert not (tmp_path / "r").exists()
