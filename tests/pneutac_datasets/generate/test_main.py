"""`python -m pneutac_datasets.generate`: every device, what is hidden, and options that belong to another."""

import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from lerobot_robot_pneutac.standin.world import new_gel
from pneutac_datasets.generate.__main__ import main
from pneutac_datasets.generate.standin import write_finger, write_gel
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import BodyData
from pneutac_sim.finger.fit import fit
from pneutac_sim.twin import Twin


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
    assert "minutes is 0; give 1 to 60." in capsys.readouterr().err


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
        (["--device=gel", "--minutes=2"], "--minutes is not for --device=gel, which takes --effect"),
        (["--device=standin", "--no-measured-pressure"], "--no-measured-pressure is not for"),
    ],
)
def test_bad_options_are_one_sentence(tmp_path, capsys, options, sentence):
    assert main([*options, f"--out={tmp_path / 'r'}"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(sentence) and error.count("\n") == 1
    assert not (tmp_path / "r").exists()


@pytest.fixture(scope="module")
def finger(tmp_path_factory):
    return write_finger(tmp_path_factory.mktemp("standin") / "finger", seed=1, minutes=1)


def test_it_is_no_mirror_of_the_twins_effects(finger):
    """Creep by the library explains much of it, and never all: the stated error stays above the noise."""
    assert set(finger.trials()) == {0, 1, 2}
    bench = BodyData.of(finger, Twin.builtin())
    plain = fit(Twin.builtin(), bench, effects=[])
    creeping = fit(Twin.builtin(), bench, effects=["creep"])
    assert creeping.train < 0.97 * plain.train
    assert creeping.train > 1.1 * np.sqrt(3) * 0.3  # mm, of the marker
    command, gauge = finger.column("pressure_cmd_kpa"), finger.column("pressure_kpa")
    assert np.sqrt(np.mean((command - gauge) ** 2)) > 0.3  # the air


def test_the_gel_recording_loads_and_shows_its_presses(tmp_path):
    data = GelRecording.load(write_gel(tmp_path / "gel", seed=1))
    assert data.presses[0].press.depth_mm == 0.9
    assert sum(s.role == "heldout" for s in data.samples) >= 10
    assert data.warnings == []
    for s in data.samples[:4]:
        change = np.abs(s.image.astype(int) - s.rest).mean(2)
        inside = s.near(data.px_per_mm, 1.0)
        assert change[inside].mean() > 3 * change[~s.near(data.px_per_mm)].mean()
    rest = np.asarray(Image.open(tmp_path / "gel" / "rest.png"))
    assert (rest == new_gel().rest_image).all()
