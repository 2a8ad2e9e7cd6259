"""Options that cannot work, and twins that a verb has no use for, are refused in one sentence."""

import shlex
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from generated import once
from snapshots import Sentences

from lerobot_pneutac.cli import _alone, run_verb
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin, Value

pytestmark = pytest.mark.slow
GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"
SENTENCES = Sentences("options")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with the twins of a finger, of one that asks for a payload, and of a gel; and a recording."""
    folder, loaded, gel = tmp_path_factory.mktemp("lab"), Twin.builtin(), Twin("gel", 16.0)
    loaded.effects["payload"] = {"share": Value(1.0)}
    GelModel.builtin().into_twin(gel)
    for name, twin in (("finger", Twin.builtin()), ("loaded", loaded), ("gel", gel)):
        twin.save(folder / name)
    new_twin("finger", length_mm=95.0).save(folder / "short")
    text = (folder / "short" / "twin.yaml").read_text().replace("length_mm: 95.0", "length_mm: 1.0e+30")
    (folder / "endless").mkdir()
    (folder / "other").mkdir()
    (folder / "film.mp4").touch()
    (folder / "log.csv").write_text("t,pressure_cmd_kpa\n0,1\n")
    (folder / "other" / "notes.txt").write_text("mine")
    (folder / "endless" / "twin.yaml").write_text(text)
    shutil.copytree(GOLDEN / "finger_creep", folder / "bench")
    shutil.copytree(GOLDEN / "demos", folder / "shown")
    for name in ("presses", "spoilt"):
        once(write_gel_recording, folder=folder / name, seed=0)
    file = folder / "spoilt" / "images" / "ball_0.png"
    cv2.imwrite(str(file), cv2.imread(str(file)).astype(np.uint16) * 256)
    return folder


@pytest.mark.parametrize("line", SENTENCES.commands)
def test_what_cannot_work_is_one_sentence_and_writes_nothing(lab, monkeypatch, line):
    monkeypatch.chdir(lab)
    name, *options = shlex.split(line)
    said = SENTENCES.check(f"pneutac {line}", lambda: run_verb(name, options))
    assert "\n" not in said and not (lab / "o").exists() and not (lab / "outputs").exists()


def test_a_report_overwrites_that_of_the_same_command_alone(lab, monkeypatch, capsys):
    monkeypatch.chdir(lab)
    new_twin("finger", length_mm=118.5).save(lab / "long")
    compare = shlex.split("--twin=long --recording=bench --out=compared")
    run_verb("compare", compare)
    run_verb("compare", compare)  # again is fine
    with pytest.raises(InputError, match="^--out=compared holds the report of `pneutac compare`"):
        run_verb("report", ["long", "--out=compared"])
    with pytest.raises(InputError, match="^--out=compared holds the report of another `pneutac compare`;"):
        run_verb("compare", [*compare, "--seed=3"])
    with pytest.raises(InputError, match="^--out=compared holds the report of `pneutac compare`"):
        run_verb("effects", ["show", "creep", "--out=compared"])
    for _ in range(2):
        run_verb("effects", ["show", "creep", "--out=effect"])
    with pytest.raises(InputError, match="^--out=effect holds the report of another `pneutac effects`"):
        run_verb("effects", ["show", "leak", "--out=effect"])


@pytest.mark.parametrize(
    ("verb", "line"),
    [
        ("export", "--twin=long --out=is_there.py"),
        ("effects", "export creep --out=is_there.py"),
        ("report", "long --rrd=is_there.rrd"),
        ("measure", "--chessboard=bench --intrinsics=is_there.json"),
    ],
)
def test_no_file_is_replaced(lab, monkeypatch, verb, line):
    monkeypatch.chdir(lab)
    new_twin("finger", length_mm=118.5).save(lab / "long")
    file = Path(line.rpartition("=")[2])
    file.write_text("mine")
    with pytest.raises(InputError, match=rf"{file.name} is there already; give a new name, or delete it"):
        run_verb(verb, shlex.split(line))
    assert file.read_text() == "mine"


def test_new_says_where_a_recording_gives_the_geometry_alone(lab, monkeypatch, capsys):
    monkeypatch.chdir(lab)
    rows = "\n".join(f"0,{0.1 * k:.1f},{k},{0.1 * k:.1f}" for k in range(2))
    Path("two.csv").write_text(f"trial,time_s,pressure_cmd_kpa,bend_angle_rad\n{rows}\n")
    run_verb("new", shlex.split("--twin=two --recording=two.csv --length_mm=90 --yes"))
    assert "nothing can be fitted to it: two.recording/samples.csv has 2 rows" in capsys.readouterr().out


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="o cannot be written"), _alone(tmp_path / "file" / "o"):
        pass
