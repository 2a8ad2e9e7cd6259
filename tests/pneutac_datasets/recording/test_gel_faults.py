"""`check` of a gel's recording opens every image, and compares images, rows and rest images."""

import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
from generated import once
from PIL import Image

from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_datasets.recording.checks import recording_faults
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError


@pytest.fixture
def folder(tmp_path):
    once(write_gel_recording, folder=tmp_path / "gel", seed=0)
    return tmp_path / "gel"


def picture(name, change):
    """Changes an image, (H, W, 3) floats."""

    def spoil(folder):
        image = change(np.array(Image.open(folder / name), float))
        Image.fromarray(np.clip(image, 0, 255).astype(np.uint8)).save(folder / name)

    return spoil


def rows(**changes):
    def spoil(folder):
        table = pd.read_csv(folder / "samples.csv")
        table = table.assign(**{k: v(table) for k, v in changes.items()}).drop(columns="contact_radius_px")
        table.to_csv(folder / "samples.csv", index=False)

    return spoil


def field(**changes):
    def spoil(folder):
        file = folder / "recording.json"
        file.write_text(json.dumps(json.loads(file.read_text()) | changes))
        rows()(folder)

    return spoil


def pointer(name):
    return lambda folder: (folder / name).write_text("version https://git-lfs.github.com/spec/v1\n")


def imprint(image):
    y, x = np.indices(image.shape[:2])
    return image + 25 * np.exp(-(((x - 150) / 12) ** 2 + ((y - 90) / 12) ** 2))[..., None]


def pressed(folder):
    shutil.copy(folder / "images/ball_3.png", folder / "rest.png")


def swap(folder):
    rest, press = folder / "rest.png", folder / "images" / "ball_0.png"
    before = rest.read_bytes()
    rest.write_bytes(press.read_bytes())
    press.write_bytes(before)


def rename(folder, before, after):
    table = pd.read_csv(folder / "samples.csv")
    table.rename(columns={before: after}).to_csv(folder / "samples.csv", index=False)


ONE = "images/ball_3.png"
FAULTS = {
    "rest is a pointer": (pointer("rest.png"), "rest.png is a Git LFS pointer"),
    "a press is a pointer": (pointer(ONE), "ball_3.png is a Git LFS pointer"),
    "black press": (picture(ONE, lambda i: 0 * i), "row 4: image 'images/ball_3.png' is black all over"),
    "white press": (picture(ONE, lambda i: 0 * i + 255), "is white all over"),
    "black rest": (picture("rest.png", lambda i: 0 * i), "rest image 'rest.png' is black all over"),
    "white rest": (picture("rest.png", lambda i: 0 * i + 255), "rest image 'rest.png' is white all over"),
    "wrong size": (picture(ONE, lambda i: i[:100]), "row 4: image 'images/ball_3.png' is 240 x 100 pixels"),
    "turned by a quarter": (picture("rest.png", lambda i: np.rot90(i)), "is 240 x 320 pixels but the rest"),
    "not there": (lambda f: (f / ONE).unlink(), "ball_3.png is missing"),
    "no picture": (lambda f: (f / ONE).write_text("404"), "ball_3.png cannot be read as an image"),
    "no rest named": (field(rest_image=""), "field 'rest_image' is missing"),
    "a number for the rest": (field(rest_image=3), "rest image 3 is no file's name"),
    "no image named": (rows(image=lambda t: np.nan), "row 1: image 'nan' is no file's name.* 6 more"),
    "a size of two": (field(gel_size_mm=[20, 15]), "field 'gel_size_mm' is .20, 15.; give width, height"),
    "a thickness below 0": (field(gel_size_mm=[20, 15, -3]), "field 'gel_size_mm' is .20, 15, -3."),
    "misspelt": (lambda f: rename(f, "depth_mm", "deph_mm"), "'deph_mm' is not read; did you mean 'depth_mm"),
    "slash": (field(rest_image="/rest.png"), "lies outside .* name it 'rest.png'"),
    "outside": (field(rest_image="../../rest.png"), "lies outside the recording's folder"),
    "indenter": (rows(indenter=lambda t: "bal"), "row 1: indenter is 'bal'; it must be one of"),
    "two pointers": (
        lambda f: [pointer(f"images/ball_{i}.png")(f) for i in "14"], r"ball_1.*for 1 more \(ball_4.png\)\.$"
    ),
    "another size of the rest": (
        lambda f: Image.open(f / "rest.png").resize((216, 288)).save(f / "rest.png"),
        r"^\S+, row 1: .* give images of one size\. The same .* for 6 more \(row 2, row 3, row 4, \.{3}\)\.$",
    ),
    "depth": (rows(depth_mm=lambda t: 9 * t.depth_mm), "depth_mm is 8.1 but the gel is"),
    "place": (rows(x_mm=lambda t: t.x_mm * 10), "lies outside the image"),
    "no calibration": (rows(role=lambda t: "heldout"), "no row with role 'calibration'"),
    "swapped": (swap, "swapped"),
    "calibration without contact": (
        lambda f: shutil.copy(f / "rest.png", f / "images/ball_0.png"),
        "are the same picture",
    ),
}  # fmt: skip


@pytest.mark.parametrize("bad", FAULTS)
def test_check_says_all_that_calibrate_refuses(folder, bad):
    spoil, said = FAULTS[bad]
    spoil(folder)
    faults, notes = recording_faults(folder)
    assert any(re.search(said, fault) for fault in faults), faults
    assert not any("BytesIO" in fault for fault in faults) and not notes
    from lerobot_pneutac.verbs.calibrate import calibrate
    from pneutac_sim.twin import Twin

    with pytest.raises(InputError):
        calibrate(Twin.builtin(), Recording.load(folder))


def test_a_good_recording_has_neither_faults_nor_notes(folder):
    assert recording_faults(folder) == ([], [])


NOTES = {
    "rest with a press": (pressed, "the rest image shows something at ("),
    "rest with an imprint": (picture("rest.png", imprint), "at (1.6, -3.5) mm that the presses do not"),
    "darker rest": (picture("rest.png", lambda i: 0.85 * i), "the rest image is 15% darker than the presses"),
    "brighter rest": (picture("rest.png", lambda i: 1.15 * i), "brighter than the presses"),
    "mirrored x": (rows(x_mm=lambda t: -t.x_mm), "opposite to x_mm"),
    "exchanged": (rows(x_mm=lambda t: t.y_mm, y_mm=lambda t: t.x_mm), "with x and y exchanged against"),
    "a quarter": (rows(x_mm=lambda t: t.y_mm, y_mm=lambda t: -t.x_mm), "turned by a quarter"),
    "depth in cm": (rows(depth_mm=lambda t: t.depth_mm / 10), "times as wide as depth_mm and the indenter"),
}


@pytest.mark.parametrize("bad", NOTES)
def test_images_rows_and_rest_images_are_compared(folder, bad):
    spoil, said = NOTES[bad]
    spoil(folder)
    found = GelRecording.load(Recording.load(folder)).warnings
    assert any(said in note for note in found), found


@pytest.mark.parametrize("scale", [12.0, 27.0])
def test_a_wrong_scale_is_said_with_the_right_one(folder, scale):
    field(px_per_mm=scale)(folder)
    found = GelRecording.load(Recording.load(folder)).warnings
    (note,) = found
    assert f"px_per_mm {scale:g} say; is px_per_mm" in note
    assert float(note.rstrip("?").split()[-1]) == pytest.approx(20.0, rel=0.05)


def test_one_press_that_the_fit_misses_is_named():
    from types import SimpleNamespace

    from lerobot_pneutac.verbs.fit_gel import OURS, REST, poor_presses

    def scores(*levels):
        return [SimpleNamespace(rmse=level) for level in levels]

    data = SimpleNamespace(samples=[SimpleNamespace(name=f"{i}.png") for i in range(5)])
    rest = scores(10, 11, 9, 10, 12)
    (sentence,) = poor_presses({OURS: scores(4, 4, 4, 12, 5), REST: rest}, data)
    assert "Row 4 ('3.png') is missed by 12.0 levels, 1.20 times what the rest image" in sentence
    assert poor_presses({OURS: scores(4, 4, 4, 5, 5), REST: rest}, data) == []
    assert poor_presses({OURS: rest, REST: rest}, data) == []  # all are poor: no single one


def test_a_bodys_photographs_are_looked_at(tmp_path):
    """Of hundreds the first and the last are decoded; a pointer or a missing file is said of all."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"trial": 0, "time_s": np.arange(30) / 10, "pressure_cmd_kpa": np.arange(30) % 10.0})
    table["bend_angle_rad"] = 0.02 * table.pressure_cmd_kpa + rng.normal(0, 0.001, 30)
    table["image_side"] = [f"{i}.png" for i in range(30)]
    for name in table.image_side:
        Image.new("RGB", (8, 8), (90, 90, 90)).save(tmp_path / name)
    table.to_csv(tmp_path / "samples.csv", index=False)
    (tmp_path / "recording.json").write_text(json.dumps({"device": "finger", "length_mm": 100}))
    assert recording_faults(tmp_path)[0] == []
    pointer("7.png")(tmp_path)
    (tmp_path / "9.png").unlink()
    (tmp_path / "29.png").write_text("404")
    faults = " ".join(recording_faults(tmp_path)[0])
    for said in ("7.png is a Git LFS pointer", "9.png is missing", "29.png cannot be read as an image"):
        assert said in faults
