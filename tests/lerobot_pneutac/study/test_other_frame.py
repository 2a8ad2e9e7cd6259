"""Recordings whose tip is in another unit or frame than their columns say, against a twin of 100 mm."""

import re

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.study.pair import same_body, unlike_the_twin
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value

TWIN = Twin("finger", 100.0, [12.5, 37.5, 62.5, 87.5])


def recording(change=lambda x, z: (x, z), meta=None) -> Recording:
    """An arc of 100 mm that bends by 1.2 rad at 60 kPa, by a saturating curve, with noise of 0.2 mm."""
    rng = np.random.default_rng(3)
    kpa = np.repeat(np.append(0.0, rng.uniform(0, 60, 39)), 20)
    bend = 1.2 * np.tanh(kpa / 40) / np.tanh(1.5) + 1e-6
    x, z = 100 * np.sin(bend) / bend, 100 * (1 - np.cos(bend)) / bend
    x, z = change(*(v + rng.normal(0, 0.2, len(v)) for v in (x, z)))
    samples = {"trial": 0, "time_s": np.arange(len(kpa)) / 10, "pressure_cmd_kpa": kpa}
    samples |= {"tip_x_mm": x, "tip_z_mm": z}
    return Recording("bench", {"device": "finger"} | (meta or {}), pd.DataFrame(samples), "finger")


@pytest.mark.parametrize(("unit", "mm"), [("inches", 25.4), ("metres", 1000.0)])
@pytest.mark.parametrize("meta", [{}, {"length_mm": 10.0, "length_proposed": True}])
def test_a_tip_in_another_unit_is_refused_by_the_length_of_the_twin(unit, mm, meta):
    with pytest.raises(InputError, match=f"can only be {unit}.*multiply the tip columns by {mm:g}"):
        same_body(TWIN, recording(lambda x, z: (x / mm, z / mm), meta), "compare")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda x, z: (x, z), ""),
        (lambda x, z: (x, -z), "'tip_z_mm' falls as the pressure rises"),
        (lambda x, z: (z, x), "lies along z and pressure bends it along x, .* the axes are exchanged"),
        (lambda x, z: (x - 100, z), "x is counted from the tip at rest; add 100 to tip_x_mm"),
        (lambda x, z: (x + 60, z - 40), r"its base is at \((59|60).*, -(38|39|40).*\) mm"),
        (lambda x, z: (0.8 * x, 0.8 * z), r"it fits a device of (78|79|80|81)"),
    ],
)
def test_a_tip_in_another_frame_is_reported_by_the_length_of_the_twin(change, sentence):
    found = check(
        same_body(TWIN, recording(change, {"length_mm": 90.0, "length_proposed": True}), "compare")
    )[1]
    said = [f for f in found if "no measured pressure" not in f and "one trial only" not in f]
    assert any(re.search(sentence, f) for f in said) if sentence else not said, said


@pytest.mark.parametrize(("kpa", "unit"), [(0.1, "mbar"), (0.001, "Pa")])
def test_a_pressure_in_a_smaller_unit_is_asked_about(kpa, unit):
    twin = TWIN.copy()
    twin.parameters["gain_rad_per_kpa"] = Value(0.005, (0.0049, 0.0051))
    given = recording()
    given.samples["pressure_cmd_kpa"] /= kpa
    found = unlike_the_twin(twin, given)
    asked = f"are the pressures in {unit}? Then multiply the pressure columns by {kpa:g}"
    assert asked in found[0] or "more than once around" in found[0]
