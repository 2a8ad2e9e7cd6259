"""`pneutac compare` of a gel: its own recording, and one whose images are mirrored or have other channels."""

import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image
from verbs import verb

from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_datasets.recording.recording import Recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A recording and a twin calibrated to it."""
    folder = tmp_path_factory.mktemp("bench")
    write_gel_recording(folder / "recording", seed=0, heldout=3)
    verb("calibrate", twin=folder / "twin", recording=folder / "recording", effects="rest_colour")
    return folder


def run(bench, recording, out):
    verb("compare", twin=bench / "twin", recording=recording, out=out)
    return json.loads((out / "result.json").read_text())


def turned(bench, folder, flip_x=False, flip_y=False, bgr=False):
    """The recording as a camera held otherwise would have taken it, contacts' places included."""
    shutil.copytree(bench / "recording", folder)
    for file in folder.rglob("*.png"):
        image = np.asarray(Image.open(file))
        image = image[:: -1 if flip_y else 1, :: -1 if flip_x else 1, :: -1 if bgr else 1]
        Image.fromarray(np.ascontiguousarray(image)).save(file)
    recording = Recording.load(folder)
    recording.samples["x_mm"] *= -1 if flip_x else 1
    recording.samples["y_mm"] *= -1 if flip_y else 1
    recording.write(folder)
    return folder


def test_a_twin_agrees_with_the_recording_that_it_was_calibrated_to(bench, tmp_path):
    result = run(bench, bench / "recording", tmp_path)
    assert result["checks"] == []
    assert result["image"]["n"] == 3 and result["image"]["rmse"] < 0.8 * result["image"]["rest_rmse"]
    assert {row["value"]: row["n"] for row in result["by"]["role"]} == {"calibration": 1, "heldout": 3}
    assert (
        result["touch"]["n"] == 3 and result["touch"]["depth_mm"] < 0.25 and result["touch"]["place_mm"] < 0.2
    )
    assert [h["change"] for h in result["history"]] == ["calibrated gel"]
    assert (tmp_path / "report.html").is_file() and (tmp_path / "tactile.png").is_file()


@pytest.mark.parametrize(
    "how, says",
    [
        pytest.param({"flip_x": True, "flip_y": True}, "turned upside down", marks=pytest.mark.nightly),
        # its lights are almost mirror images: red and green swapped look the same
        pytest.param(
            {"flip_x": True},
            "(mirrored left to right|channels GRB instead of RGB)",
            marks=pytest.mark.nightly,
        ),
        ({"flip_y": True, "bgr": True}, "channels BGR instead of RGB and mirrored top to bottom"),
    ],
    ids=lambda v: "+".join(v) if isinstance(v, dict) else "",
)
def test_turned_images_are_said_to_be_turned(how, says, bench, tmp_path, capsys):
    result = run(bench, turned(bench, tmp_path / "turned", **how), tmp_path)
    assert len(result["checks"]) == 1 and re.search(f"images are {says};", result["checks"][0])
    assert re.search(says, " ".join(capsys.readouterr().out.split()))


def test_a_recording_without_a_calibration_row_is_compared_without_a_check(bench, tmp_path):
    folder = turned(bench, tmp_path / "turned", bgr=True)
    table = folder / "samples.csv"
    table.write_text(table.read_text().replace("calibration", "heldout"))
    result = run(bench, folder, tmp_path)
    assert result["checks"] == [] and result["image"]["n"] == 4 and result["error"]["train"] is None
