"""The studio's session: versions to look at and to go back to, one work at a time, twins of other devices."""

import threading
from pathlib import Path

import pytest

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.studio.session import Session
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"


@pytest.fixture
def folder(tmp_path):
    twin = Twin.builtin()
    errors = {"train": 2.0, "heldout": 2.2, "unit": "mm", "seed": 3}
    twin.save_version(tmp_path / "finger", "calibrated", "bench", errors)
    twin.effects["creep"] = get_effect("creep").start(15.0)
    twin.save_version(tmp_path / "finger", "added creep", "bench", errors | {"heldout": 0.6})
    return tmp_path / "finger"


def test_looking_writes_nothing_and_going_back_loses_nothing(folder):
    session, told = Session(folder, None), []
    session.when_changed(lambda: told.append(session.version))
    before = (folder / "twin.yaml").read_bytes()
    session.look_at(0)
    assert not session.twin.effects and (folder / "twin.yaml").read_bytes() == before
    session.keep()
    history = Twin.load(folder).history
    assert [e["change"] for e in history] == ["calibrated", "added creep", "back to version 0: calibrated"]
    assert history[2]["heldout"] == 2.2 and history[2]["seed"] == 3 and not Twin.load(folder).effects
    session.look_at(1)
    session.keep()  # and forth
    assert "creep" in Twin.load(folder).effects and told == [0, None, 1, None]
    with pytest.raises(InputError, match="choose an earlier one"):
        session.keep()


def test_a_misspelt_twin_is_told_before_there_is_an_address(tmp_path, capsys):
    with pytest.raises(InputError, match="no twin at"):
        run_verb("studio", [f"--twin={tmp_path / 'nothing'}", "--port=0"])
    assert capsys.readouterr().out == ""


def test_one_work_at_a_time(folder):
    session, go, done = Session(folder, None), threading.Event(), threading.Event()
    session.begin("diagnosing", lambda show: go.wait(5), print)
    with pytest.raises(InputError, match="Still diagnosing"):
        session.begin("trying", lambda show: None, print)
    go.set()
    for _ in range(100):
        if not session.working:
            break
        threading.Event().wait(0.01)
    session.begin("trying", lambda show: done.set(), print)
    assert done.wait(5)


def test_what_does_not_go_together_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="no twin at"):
        Session(tmp_path / "nothing", None)
    with pytest.raises(InputError, match="--recording=DIR"):
        Session(folder, None).needs_recording()
    with pytest.raises(InputError, match="give it by --demonstrations="):
        Session(folder, GOLDEN / "demos")
    arm = tmp_path / "arm"
    arm.mkdir()
    (arm / "recording.json").write_text('{"device": "arm", "length_mm": 180, "samples": "samples.csv"}')
    head = (
        "trial,time_s,pressure_cmd_1_kpa,pressure_cmd_2_kpa,pressure_cmd_3_kpa,tip_x_mm,tip_y_mm,tip_z_mm\n"
    )
    rows = "".join(f"0,{i / 10},{i},0,0,{180 - i},0,{i}\n" for i in range(30))
    (arm / "samples.csv").write_text(head + rows)
    with pytest.raises(InputError, match="open a twin with a recording of its own device"):
        Session(folder, arm)
