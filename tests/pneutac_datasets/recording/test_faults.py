"""All faults of a recording at once.

Damaged and malicious images end in one sentence, within a second and 500 MB.

The tip's path is compared with the length of the device, and its direction with the pressure.
"""

import json
import random
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from pneutac_benchmarks.robustness.images import bomb, damage_images, read_bombs, scans
from pneutac_datasets.recording.checks import exchanged_axes, misplaced_tip, other_way_round, recording_faults
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.files import FORMATS, read_image
from pneutac_sim.finger.inputs import pressure_columns


def test_every_fault_is_said_and_misspelt_names_are_reported_what_they_may_mean(tmp_path):
    good, meta = finger(length=110.0), {"device": "finger", "length_mm": 110.0}
    folder, p = good.write(tmp_path / "r"), good.samples["pressure_cmd_kpa"]
    faults, notes = recording_faults(folder)
    assert faults == [] and all(isinstance(n, str) for n in notes)
    of_arm = recording_faults(finger(device="arm").write(tmp_path / "arm"))
    assert of_arm[0] == [] and not [n for n in of_arm[1] if "is not read" in n]
    table = good.samples.assign(pressure_kpa=1e5 * p, temperature_c=20.0)
    table.loc[7, "temperature_c"] = np.nan
    table[["tip_x_mm", "tip_y_mm", "tip_z_mm"]] /= 1e5
    table = table.rename(columns={"pressure_cmd_kpa": "presure_cmd_kpa", "time_s": "tiem_s"})
    table.to_csv(folder / "samples.csv", index=False)
    spoilt = meta | {"noise": {"tip_x_mm": -1}, "spine_joint_position_mm": [10.0]}
    (folder / "recording.json").write_text(json.dumps(spoilt))
    top, (faults, _) = p.idxmax(), recording_faults(folder)
    for words in (
        "field 'noise' of 'tip_x_mm' is -1",
        "unknown field 'spine_joint_position_mm'; did you mean 'spine_joint_positions_mm'?",
        "column 'time_s' is missing (there is 'tiem_s': rename it",
        "column 'pressure_cmd_kpa' is missing (there is 'presure_cmd_kpa': rename it",
        "column 'temperature_c', row 8 (line 9 of the file) is empty",
        f"column 'pressure_kpa', row {top + 1} (line {top + 2} of the file) is {1e5 * p[top]:g}",
        "which can only be metres",
    ):
        assert sum(words in f for f in faults) == 1, words
    assert len(faults) == 7
    with pytest.raises(InputError, match="unknown field 'spine_joint_position_mm'"):
        Recording.load(folder)
    (folder / "recording.json").write_text(json.dumps(meta))
    with pytest.raises(InputError, match="'time_s' is missing .* Missing too: 'pressure_cmd_kpa'"):
        Recording.load(folder)


@pytest.mark.parametrize("number", [120, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_a_damaged_image_is_read_or_refused_in_a_sentence(number):
    outcome = damage_images(number)
    assert outcome.broken == () and 0.3 * number < outcome.refused < number


@pytest.mark.slow
def test_small_files_that_stand_for_huge_pictures_cost_little():
    assert read_bombs().broken == ()


def test_limits_are_reported(tmp_path):
    with pytest.raises(InputError, match="huge.png states 9000 x 9000 pixels, above the limit of 25 million"):
        read_image(bomb(9000, 9000), "huge.png")
    with pytest.raises(InputError, match="scans"):
        read_image(scans(100), "slow.jpg")
    (tmp_path / "large.png").touch()
    with (tmp_path / "large.png").open("r+b") as file:
        file.truncate(81 * 2**20)  # a hole, which takes no space
    with pytest.raises(InputError, match="large.png has 81 MB, above the limit of 80 MB"):
        read_image(tmp_path / "large.png")


@pytest.mark.parametrize("kind", ["EPS", "GIF"])
def test_no_other_format_is_opened(tmp_path, kind):
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png", kind)
    with pytest.raises(InputError, match="cannot be read as an image"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("kind", FORMATS)
def test_pixels_are_those_of_the_file(tmp_path, kind):
    colour = tuple(random.Random(1).randbytes(3))
    Image.new("RGB", (8, 4), colour).save(tmp_path / "a", kind)
    image = read_image(tmp_path / "a", plain=True)
    assert image.shape == (4, 8, 3) and abs(image.astype(int) - colour).max() <= 3  # JPEG loses a little


def finger(
    length=100.0, most_rad=0.5, rest_rad=0.05, stretch=0.0, turned_rad=0.0, device="finger", stated=None
):
    """A device that bends evenly under steps of pressure, seen with 0.1 % of noise."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(0, 20, 30), 40).round(2)
    t = rest_rad + most_rad * u / 20
    n, far = len(u), length * (1 + stretch * u / 20)
    tip = np.stack([np.sin(t), 0 * t, 1 - np.cos(t)], -1) / t[:, None] * far[:, None]
    tip[:, 1:] = np.stack([-np.sin(turned_rad) * tip[:, 2], np.cos(turned_rad) * tip[:, 2]], -1)
    tip += 1e-3 * length * rng.normal(size=tip.shape)
    s = {"trial": np.repeat([0, 1], n // 2), "time_s": np.tile(np.arange(n // 2) / 20, 2)}
    s |= dict.fromkeys(pressure_columns(device)[0], u) | {
        f"tip_{a}_mm": tip[:, i] for i, a in enumerate("xyz")
    }
    return Recording(Path("r"), {"length_mm": stated or length}, pd.DataFrame(s), device)


def of_frame(recording):
    return [f for look in (misplaced_tip, other_way_round, exchanged_axes) for f in look(recording)]


@pytest.mark.parametrize("length", [12.0, 600.0])
@pytest.mark.parametrize("most_rad", [0.2, 2.5])
@pytest.mark.parametrize(("stretch", "device"), [(0.0, "finger"), (0.1, "arm")])
def test_a_tip_on_its_path_has_no_finding(length, most_rad, stretch, device):
    assert of_frame(finger(length, most_rad, stretch=stretch, device=device)) == []
    assert of_frame(finger(length, most_rad, stated=1.05 * length)) == []  # a rough ruler
    assert of_frame(finger(length, most_rad, rest_rad=0.6)) == []  # bent at rest


WAYS = {
    "in centimetres; multiply by 10": lambda s: s / 10,
    "in inches; multiply by 25.4": lambda s: s / 25.4,
    "x is counted from the tip at rest": lambda s: s - [1, 0, 0],
    "change the sign of tip_x_mm": lambda s: s * [-1, 1, 1],
    "tip_x_mm can only be in centimetres": lambda s: s / [10, 1, 1],
    "tip_y_mm and tip_z_mm can only be in metres": lambda s: s / [1, 1000, 1000],
    "tip_y_mm and tip_z_mm can only be in centimetres": lambda s: s / [1, 10, 10],
    "tip_y_mm and tip_z_mm can only be in inches": lambda s: s / [1, 25.4, 25.4],
}


@pytest.mark.parametrize("words", WAYS)
@pytest.mark.parametrize(("length", "most_rad", "turned_rad"), [(30.0, 1.5, 0.0), (400.0, 0.5, 0.5)])
def test_a_tip_in_another_unit_or_frame_is_named(words, length, most_rad, turned_rad):
    r = finger(length, most_rad, turned_rad=turned_rad)
    names = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
    r.samples[names] = length * WAYS[words](r.samples[names].to_numpy() / length)
    (f,) = of_frame(r)
    assert f.kind == "misplaced_tip" and words in f.sentence and f"of {length:g} mm" in f.sentence


@pytest.mark.parametrize("stated", [60.0, 250.0])
def test_a_length_that_is_not_the_tips_is_named_with_the_one_that_is(stated):
    (f,) = of_frame(finger(118.5, 1.0, stated=stated))
    found = float(f.sentence.split("fits a device of ")[1].split()[0])
    assert found == pytest.approx(118.5, rel=0.06)


@pytest.mark.parametrize("most_rad", [0.3, 1.0])
def test_a_finger_that_bends_the_other_way_round_is_named(most_rad):
    r = finger(most_rad=most_rad)
    r.samples["tip_z_mm"] *= -1
    (f,) = of_frame(r)
    assert f.kind == "other_way_round" and "change the sign of the column" in f.sentence
    r.samples["pressure_cmd_kpa"] *= -1  # by vacuum, where that is no sign of anything
    assert of_frame(r) == []


def test_an_angle_that_falls_with_the_pressure_is_named():
    r = finger()
    r.samples = r.samples.drop(columns=["tip_x_mm", "tip_y_mm", "tip_z_mm"])
    r.samples["bend_angle_rad"] = -0.02 * r.samples["pressure_cmd_kpa"]
    (f,) = of_frame(r)
    assert f.columns == ("bend_angle_rad",)
