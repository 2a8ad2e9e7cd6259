"""What bad input is told, word for word: `tests/snapshots/sentences.txt` holds a sentence for each case."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from snapshots import Sentences

from lerobot_pneutac.cli import _dispatch
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin

# Commands run in a folder with twins `finger`, `arm` and `gel`, and a recording `bench` of the finger.
SENTENCES = Sentences("sentences")


def field(**changes):
    """Changes fields of recording.json; None takes one out."""

    def spoil(folder):
        meta = json.loads((folder / "recording.json").read_text())
        kept = {k: v for k, v in (meta | changes).items() if v is not None}
        (folder / "recording.json").write_text(json.dumps(kept))

    return spoil


def table(change):
    """Changes the table of samples."""

    def spoil(folder):
        changed = change(pd.read_csv(folder / "samples.csv", dtype=object))
        changed.to_csv(folder / "samples.csv", index=False)

    return spoil


def cell(column, row, value):
    def change(samples):
        samples.loc[row, column] = value
        return samples

    return table(change)


def text(file, content):
    return lambda folder: (folder / file).write_text(content)


def replaced(file, before, after):
    def spoil(folder):
        content = (folder / file).read_text()
        assert before in content
        (folder / file).write_text(content.replace(before, after))

    return spoil


RECORDINGS = {
    "no recording.json": lambda folder: (folder / "recording.json").unlink(),
    "no samples.csv": lambda folder: (folder / "samples.csv").unlink(),
    "recording.json is no JSON": text("recording.json", '{"device": '),
    "recording.json is a list": text("recording.json", "[]"),
    "no device": field(device=None),
    "another device": field(device="hand"),
    "a length in metres": field(length_mm=0.11),
    "a negative length": field(length_mm=-110),
    "samples outside the folder": field(samples="../samples.csv"),
    "samples of another kind": field(samples="samples.xlsx"),
    "joints that do not rise": field(spine_joint_positions_mm=[50, 20]),
    "joints beyond the tip": field(spine_joint_positions_mm=[20, 300]),
    "an empty table": text("samples.csv", ""),
    "a table without rows": table(lambda s: s[:0]),
    "no time": table(lambda s: s.drop(columns="time_s")),
    "no trial": table(lambda s: s.drop(columns="trial")),
    "no pressure": table(lambda s: s.drop(columns="pressure_cmd_kpa")),
    "no pose": table(lambda s: s.drop(columns=["tip_x_mm", "tip_y_mm", "tip_z_mm"])),
    "a word for a number": cell("pressure_cmd_kpa", 7, "high"),
    "time goes back": cell("time_s", 9, "0.05"),
    "a trial that is no number": cell("trial", 3, "first"),
    "a column twice": text("samples.csv", "trial,time_s,time_s,pressure_cmd_kpa\n0,0,0,1\n"),
    "noise of no column": field(noise={"tip_w_mm": 0.1}),
    "a camera that is misspelt": field(cameras={"front": {"intrinsic": [[1]]}}),
    "cameras as a list": field(cameras=["front"]),
    "a table as recording.json": text("recording.json", "trial,time_s\n0,0\n"),
    "a picture as recording.json": lambda folder: (folder / "recording.json").write_bytes(b"\x89PNG\r\n"),
    "a field twice": text("recording.json", '{"device": "finger", "device": "arm"}'),
    "negative noise": field(noise={"tip_x_mm": -0.1}),
    "a trial that is not there": field(trials={"5": {"start": "rested"}}),
    "another start of a trial": field(trials={"1": {"start": "fresh"}}),
    "a negative pause": field(trials={"1": {"start": "continues", "pause_s": -2}}),
    "a pause after a rest": field(trials={"1": {"start": "rested", "pause_s": 12}}),
    "a first trial that continues": field(trials={"0": {"start": "continues"}}),
    "a command sent too late": table(lambda s: s.assign(time_sent_s=s.time_s.astype(float) + 0.3)),
    "a command sent too early": table(lambda s: s.assign(time_sent_s=s.time_s.astype(float) - 0.3)),
}

TWINS = {
    "no twin.yaml": lambda folder: (folder / "twin.yaml").unlink(),
    "no YAML": text("twin.yaml", "device: [finger"),
    "another format": replaced("twin.yaml", "format: ", "format: other-"),
    "another device": replaced("twin.yaml", "device: finger", "device: hand"),
    "no device": replaced("twin.yaml", "device: finger", "gadget: finger"),
    "a negative length": replaced("twin.yaml", "length_mm: 110.0", "length_mm: -110.0"),
    "a length in words": replaced("twin.yaml", "length_mm: 110.0", "length_mm: long"),
    "a joint before the base": replaced("twin.yaml", "mm:\n- 13.75", "mm:\n- -13.75"),
    "a gel's light that is no number": replaced("twin.yaml", "gel: {}", "gel: {light: [.nan]}"),
    "effects as a list": replaced("twin.yaml", "effects: {}", "effects: [creep]"),
    "an effect without a value": replaced("twin.yaml", "effects: {}", "effects: {creep: {weight_4s: 0.1}}"),
    "no gain": replaced("twin.yaml", "gain_rad_per_kpa:", "curl_rad:"),
    "a version that is misspelt": replaced("twin.yaml", "history: []", "history: [{version: 0, chnge: new}]"),
    "broken arrays": lambda folder: (folder / "arrays.safetensors").write_bytes(b"no arrays"),
}


def write_bench(folder: Path) -> None:
    """A minute of a finger that follows its pressure, in two trials."""
    t = np.arange(0, 30, 0.1)
    p = np.round(5 + 5 * np.sin(t), 3)
    one = {
        "time_s": np.round(t, 2),
        "pressure_cmd_kpa": p,
        "tip_x_mm": np.round(109 - 0.3 * p, 3),
        "tip_y_mm": 0.0,
    }
    two = [{"trial": k} | one | {"tip_z_mm": np.round(3 * p + k, 3)} for k in (0, 1)]
    folder.mkdir()
    pd.concat(map(pd.DataFrame, two)).to_csv(folder / "samples.csv", index=False)
    meta = {"device": "finger", "length_mm": 110.0, "samples": "samples.csv"}
    (folder / "recording.json").write_text(json.dumps(meta))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("sentences")
    Twin.builtin().save(path / "finger")
    new_twin("arm", length_mm=200.0).save(path / "arm")
    Twin("gel", 16.0).save(path / "gel")
    write_bench(path / "bench")
    (path / "broken.yaml").write_text("twin: [a")
    (path / "list.yaml").write_text("- twin")
    (path / "typo.yaml").write_text("twim: finger")
    (path / "switch.yaml").write_text("by: no")
    return path


@pytest.mark.parametrize("line", SENTENCES.commands)
def test_a_command(line, folder, monkeypatch):
    monkeypatch.chdir(folder)
    SENTENCES.check(f"pneutac {line}", lambda: _dispatch(line.split()))


@pytest.mark.parametrize("fault", RECORDINGS)
def test_a_recording(fault, folder, monkeypatch):
    monkeypatch.chdir(folder)
    shutil.rmtree("bad", ignore_errors=True)
    shutil.copytree("bench", "bad")
    RECORDINGS[fault](Path("bad"))
    SENTENCES.check(f"recording: {fault}", lambda: Recording.load("bad"))


@pytest.mark.parametrize("fault", TWINS)
def test_a_twin(fault, folder, monkeypatch):
    monkeypatch.chdir(folder)
    shutil.rmtree("spoilt", ignore_errors=True)
    shutil.copytree("finger", "spoilt")
    TWINS[fault](Path("spoilt"))
    SENTENCES.check(f"twin: {fault}", lambda: Twin.load("spoilt"))


def test_the_unspoilt_are_taken(folder):
    assert len(Recording.load(folder / "bench")) == 600
    assert Twin.load(folder / "finger").device == "finger"
