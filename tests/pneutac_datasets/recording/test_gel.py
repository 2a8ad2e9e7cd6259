"""A gel's recording: which rest image and which clock each photograph has, sizes, depths, bad input."""

import json

import numpy as np
import pandas as pd
import pytest
import trimesh
from generated import once
from PIL import Image

from pneutac_datasets.generate.gel import write_hidden_gel
from pneutac_datasets.recording.gel import ASSUMED_RADIUS_MM, GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

COLOURS = {"rest.png": 60, "later.png": 90, "a.png": 100, "b.png": 110, "c.png": 120}
META = {"device": "gel", "rest_image": "rest.png", "samples": "samples.csv", "px_per_mm": 20.0}


@pytest.fixture
def write(tmp_path):
    """Writes and loads a recording of three plain pictures with these columns and fields."""

    def write(columns=(), fields=(), drop=(), to_fit=False):
        for name, level in COLOURS.items():
            Image.new("RGB", (60, 80), (level, level, level)).save(tmp_path / name)
        table = {"role": ["calibration", "heldout", "heldout"], "trial": [0, 0, 0], "time_s": [0.0] * 3}
        table |= {"image": ["a.png", "b.png", "c.png"], "indenter": "sphere", "indenter_radius_mm": 2.0}
        table |= {"x_mm": [0.0, 0.5, -0.5], "y_mm": [0.0, 1.0, -1.0], "depth_mm": 0.5}
        table = {k: v for k, v in (table | dict(columns)).items() if k not in drop}
        pd.DataFrame(table).to_csv(tmp_path / "samples.csv", index=False)
        meta = {k: v for k, v in (META | dict(fields)).items() if v is not None}
        (tmp_path / "recording.json").write_text(json.dumps(meta))
        return GelRecording.load(Recording.load(tmp_path), to_fit)

    return write


# ---------------------------------------------------------------- uncertain presses


def test_a_row_says_what_of_its_press_is_uncertain(write):
    sd = {"place_sd_mm": [0.3, 0.3, ""], "tilt_sd_rad": 0.02, "depth_sd_mm": 0}
    data = write(sd | {"role": ["calibration", "known_depth", ""]})
    lean = {"tilt_x_rad": 0.02, "tilt_y_rad": 0.02}
    assert [s.sd for s in data.samples] == [{"x_mm": 0.3, "y_mm": 0.3} | lean, {}, lean]


# ---------------------------------------------------------------- what came before


def test_holds_tell_what_was_pressed_before_since_the_rest_image(write):
    times = {"time_s": [20.0, 25.0, 60.0], "hold_s": [20.0, 2.0, 30.0]}
    first, second, third = write(times).samples
    assert first.earlier == ()
    assert [(e.press, e.held_s, e.since_s) for e in third.earlier] == [
        (first.press, 20.0, 40.0),
        (second.press, 2.0, 35.0),
    ]
    assert not any(s.earlier for s in write({"time_s": times["time_s"]}).samples)
    anew = write(times | {"rest_image": ["", "later.png", "later.png"]}).samples
    assert [len(s.earlier) for s in anew] == [0, 0, 1], "its own rest image shows what was left before it"


# ---------------------------------------------------------------- rest images


def test_a_row_may_have_a_rest_image_of_its_own(write):
    data = write({"rest_image": ["", "later.png", "later.png"]})
    assert data.samples[0].rest is data.rest
    assert (data.samples[1].rest == 90).all()
    assert data.samples[2].rest is data.samples[1].rest, "one session, one image"
    assert (data.samples[1].image == 110).all()


# ---------------------------------------------------------------- clock


@pytest.mark.parametrize(
    "columns, expected",
    [
        ({"time_s": [10.0, 30.0, 50.0]}, [0, 0.5, 1]),
        ({"time_s": [0.0, 1.0, 4.0], "trial": 7}, [0, 0.25, 1]),
        ({"trial": [2, 3, 6]}, [0, 0.25, 1]),
        ({"trial": [0, 0, 1], "time_s": [0.0, 1.0, 0.0]}, [0, 0, 1]),
        ({}, [0, 0.5, 1]),
    ],
    ids=["time", "time before trial", "trial", "trial where time restarts", "row"],
)
def test_the_clock_goes_by_time_else_by_trial_else_by_row(columns, expected, write):
    assert [s.clock for s in write(columns).samples] == pytest.approx(expected)


# ---------------------------------------------------------------- what pressed where


def test_places_in_millimetres_and_pixels_agree(write):
    data = write()
    s = data.samples[1]
    assert (s.x_px, s.y_px) == (30 + 10, 40 + 20)
    data = write({"contact_x_px": [30, 40, 20], "contact_y_px": [40, 60, 20]}, drop=("x_mm", "y_mm"))
    t = data.samples[1]
    assert (t.press.x_mm, t.press.y_mm) == (s.press.x_mm, s.press.y_mm) == (0.5, 1.0)
    assert s.radius_px == pytest.approx(20 * np.sqrt(2.0 * 0.5)), "Hertz: a^2 = R d"


def test_depth_and_radius_are_read_from_the_contacts_radius_where_they_are_empty(write):
    columns = {"contact_radius_px": 20.0, "depth_mm": np.nan, "indenter_radius_mm": np.nan}
    data = write(columns)
    press = data.samples[0].press
    assert press.size_mm == ASSUMED_RADIUS_MM and press.depth_mm == pytest.approx(1 / ASSUMED_RADIUS_MM)
    assert sum("is assumed" in w for w in data.warnings) == 1


def test_the_calibration_is_the_row_that_says_so(write):
    assert write({"role": ["heldout", "calibration", "calibration"]}).presses[0].name == "b.png"
    with pytest.raises(InputError, match="no row with role 'calibration'"):
        write({"role": "heldout"}, to_fit=True)


BEFORE = {"time_s": [20.0, 25.0, 60.0]}
BAD = [
    ({"x_mm": [0, np.nan, 0]}, "row 2: the contact's place is empty"),
    ({"depth_mm": [0.5, 0.5, np.nan]}, "row 3: depth_mm is empty"),
    ({"x_mm": 7.0}, "contact's centre, 7 mm along x, lies outside the image, which goes to 1.5 mm"),
    ({"x_mm": 0.4, "contact_x_px": 10.0}, "row 1: x_mm is 0.4 but contact_x_px, 10, lies at -1 mm"),
    ({"depth_sd_mm": [0.1, -1.0, 0.1]}, "row 2: depth_sd_mm is -1; give a standard deviation, or leave it"),
    ({"indenter": "cube", "indenter_radius_mm": np.nan}, "give the cube's size"),
    ({"indenter": "outline"}, "row 1: outline_mm is empty"),
    ({"indenter": "outline", "outline_mm": "-2 -2; 2 2; 2 -2; -2 2"}, "row 1: outline_mm crosses itself"),
    ({"indenter": "mesh", "indenter_file": "tip.stl"}, "There is no mesh"),
    (BEFORE | {"hold_s": [20.0, "", 2.0]}, "row 2: hold_s is nan; give the seconds that the indenter was in"),
    (BEFORE | {"hold_s": [20.0, 10.0, 2.0]}, "row 2: with time_s 25 and hold_s 10 it was pressed before the"),
]
BAD_FIELDS = [
    ({"px_per_mm": None}, "px_per_mm"),
    ({"px_per_mm": -2}, "px_per_mm"),
    ({"px_per_mm": 2000.0}, "px_per_mm is 2000, so that the image would be 0.03 mm wide"),
]


@pytest.mark.parametrize(
    ("columns", "fields", "says"), [(c, {}, s) for c, s in BAD] + [({}, f, s) for f, s in BAD_FIELDS]
)
def test_bad_rows_and_fields_get_one_sentence(columns, fields, says, write):
    with pytest.raises(InputError, match=says) as e:
        write(columns, fields)
    assert "\n" not in str(e.value)


def test_any_indenter_is_read_from_a_file_or_an_outline(write, tmp_path):
    trimesh.creation.box((4, 2, 30)).export(tmp_path / "bar.stl")
    outline = "-2 -1; 2 -1; 2 1; -2 1"
    columns = {"indenter": ["mesh", "outline", "sphere"], "indenter_file": ["bar.stl", "", ""]}
    columns |= {"outline_mm": ["", outline, ""], "x_mm": 0.0, "y_mm": 0.0}
    columns |= {"indenter_radius_mm": [np.nan] * 2 + [2]}
    bar, punch, ball = (s.press for s in write(columns).samples)
    np.testing.assert_allclose(bar.depths(), punch.depths(), atol=1e-6)
    assert bar.contact_radius_mm == pytest.approx(punch.contact_radius_mm, rel=0.03)
    assert punch.size_mm == pytest.approx(np.sqrt(5)) and ball.figure is None and punch.depths().any()


# ---------------------------------------------------------------- labels that cannot be


def test_photographs_to_score_by_that_show_nothing_are_noted(tmp_path):
    recording = once(write_hidden_gel, tmp_path / "presses", [], images=4)
    rest, press = (
        recording.folder / n for n in (recording.meta["rest_image"], recording.samples["image"][2])
    )
    pixels = np.array(Image.open(rest), float) + np.random.default_rng(0).normal(0, 2, (320, 240, 3))
    Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8)).save(tmp_path / "presses" / "nothing.png")
    bright = np.maximum(Image.open(press), 255 * (np.arange(240) > 40)[None, :, None]).astype(np.uint8)
    Image.fromarray(bright).save(tmp_path / "presses" / "bright.png")
    recording.samples.loc[1, "image"], recording.samples.loc[2, "image"] = "nothing.png", "bright.png"
    assert GelRecording.load(recording).warnings[-2:] == [
        "no contact shows where rows 2, 3 put it; check their x_mm and y_mm.",
        "most of the contact is saturated in rows 3, which stay in the fit; lower the exposure.",
    ]
