"""The tip's path is compared with the length of the device, and its direction with the pressure."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pneutac_datasets.recording.poses import exchanged_axes, misplaced_tip, other_way_round
from pneutac_datasets.recording.recording import Recording


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
    chambers = (
        {"pressure_cmd_kpa": u} if device == "finger" else {f"pressure_cmd_{i}_kpa": u for i in (1, 2, 3)}
    )
    s |= chambers | {f"tip_{a}_mm": tip[:, i] for i, a in enumerate("xyz")}
    return Recording(Path("r"), {"length_mm": stated or length}, pd.DataFrame(s), device)


def of_frame(recording):
    return [f for look in (misplaced_tip, other_way_round, exchanged_axes) for f in look(recording)]


@pytest.mark.parametrize("length", [12.0, 600.0])
@pytest.mark.parametrize("most_rad", [0.2, 0.8, 2.5])
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


@pytest.mark.parametrize("stated", [60.0, 80.0, 150.0, 250.0])
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
