"""The worked example of docs/how_to/add_an_effect.md, exactly as printed, installed beside the library.

What holds for every effect of the library.
"""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from installed import packages

from lerobot_pneutac import calibrate, compare
from pneutac_datasets.generate.gel import write_hidden_gel
from pneutac_sim.effects import BodyEffect, Parameter, all_effects, body_effects, get_effect, in_order, kernel
from pneutac_sim.effects.body_effect import SIGNALS
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, fit, simulate
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin

DOC = Path(__file__).parents[3] / "docs" / "how_to" / "add_an_effect.md"


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", DOC.read_text(), re.S)


@pytest.fixture
def package(tmp_path, monkeypatch):
    with packages(tmp_path, monkeypatch, "effects", all_effects) as install:
        yield install


@pytest.fixture
def example(package):
    project = tomllib.loads(blocks("toml")[0])["project"]
    package("pneutac_marker_offset", blocks("python")[0], project["entry-points"]["pneutac.effects"])


@pytest.fixture
def backlight(package):
    package("pneutac_backlight", blocks("python")[1], {"backlight": "pneutac_backlight:EFFECT"})
    return get_effect("backlight")


def test_each_is_under_forty_lines():
    assert all(len(block.splitlines()) < 40 for block in blocks("python"))


def test_it_is_found_last_in_its_stage_and_does_nothing_at_its_neutral_point(example):
    assert list(body_effects())[-1] == "marker_offset"
    effect = all_effects()["marker_offset"]
    x = np.random.default_rng(0).normal(size=(50, 5))
    np.testing.assert_array_equal(effect.apply(x, np.ones(50), {"offset_mm": 0.0}), x)


def test_it_is_fitted_like_any_other(example):
    n = 600
    table = {"trial": np.zeros(n, int), "time_s": np.arange(n) / 20}
    table["pressure_cmd_kpa"] = 7.5 * (1 - np.cos(table["time_s"] / 3))
    twin = Twin.builtin()
    empty = pd.DataFrame(table | {"tip_x_mm": np.zeros(n), "tip_z_mm": np.zeros(n)})
    recording = type("Recording", (), {"samples": empty, "device": "finger"})
    truth = twin.copy()
    truth.effects["marker_offset"] = all_effects()["marker_offset"].start(15.0)
    truth.effects["marker_offset"]["offset_mm"].value = 12.0
    seen = simulate(truth, BodyData.of(recording, truth)).model
    recording.samples[["tip_x_mm", "tip_z_mm"]] = seen + 0.1 * np.random.default_rng(0).normal(
        size=seen.shape
    )
    before, after = fit(twin, recording, []), fit(twin, recording, ["marker_offset"])
    assert before.train > 1.0 and after.train < 0.15
    low, high = after.ci95["marker_offset.offset_mm"]
    assert low <= 12.0 <= high


def test_a_second_effect_of_the_same_name_is_refused(package):
    package(
        "pneutac_twice", "from pneutac_sim.effects.creep import EFFECT\n", {"creep": "pneutac_twice:EFFECT"}
    )
    with pytest.raises(InputError, match="effect named 'creep'"):
        all_effects()


@pytest.mark.parametrize(
    "code, says", [("EFFECT = 1", "must be a BodyEffect"), ("import nowhere", "nowhere")]
)
def test_what_is_no_effect_is_refused_by_its_entry_point(package, code, says):
    package("pneutac_broken", code, {"broken": "pneutac_broken:EFFECT"})
    with pytest.raises(InputError, match=f"'broken'.*{says}"):
        all_effects()


@pytest.mark.slow
def test_a_sensors_effect_is_fitted_saved_and_rendered_like_any_other(backlight, tmp_path):
    recording = write_hidden_gel(tmp_path / "gel", ["rest_colour", "backlight"], images=8)
    twin = Twin(device="gel", length_mm=16.0)
    plain = calibrate(twin, recording, effects=["rest_colour"]).twin
    found = calibrate(twin, recording, effects=["rest_colour", "backlight"]).twin
    truth = json.loads((tmp_path / "truth" / "gel.json").read_text())["backlight"]
    values = {k: v.value for k, v in found.effects["backlight"].items()}
    assert np.abs([values[k] - truth[k] for k in truth]).max() < 8.0

    found.save(tmp_path / "twin")
    again = Twin.load(tmp_path / "twin")
    before, after = compare(plain, recording), compare(again, recording)
    assert after.heldout < 0.85 * before.heldout, "of which 2 levels are noise"
    depth = np.pad(np.full((20, 15), 0.6, np.float32), ((30, 30), (22, 22)))
    without = GelModel.from_twin(again)
    without.effects.pop("backlight")
    lit, unlit = TactileSensor(again), TactileSensor(without)
    assert (
        np.median(lit.image(depth).astype(int)[140:180, 105:135] - unlit.image(depth)[140:180, 105:135]) > 5
    )
    np.testing.assert_array_equal(lit.image(np.zeros_like(depth)), lit.rest_image)
    assert lit.contact_from_depth(depth) == lit.contact(lit.image(depth))


CHANNELS = {"pressure": 3, "joints": 4, "loads": 6, "markers": 5, "mount": 5}
EFFECTS = list(body_effects().values())


def signal(effect, n=400):
    rng = np.random.default_rng(0)
    x = np.repeat(rng.uniform(0, 12, (n // 20, CHANNELS[effect.signal])), 20, axis=0)
    x[100:200] += np.linspace(0, 3, 100)[:, None]
    return x


def conditions(effect, n=400):
    rng = np.random.default_rng(1)
    return rng.uniform(0.5, 5.0, (n, len(effect.columns)))


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_does_something_at_its_start_and_stays_finite_within_its_bounds(effect):
    x, dt, c = signal(effect), np.full(400, 0.05), conditions(effect)
    rng = np.random.default_rng(2)
    top = float(np.abs(x).max())
    changed = False
    for trial in range(20):
        values = {}
        for p in effect.parameters:
            default, low, high = p.limits(top)
            u = rng.random()
            values[p.name] = (
                default if trial == 0 else low * (high / low) ** u if p.log else low + u * (high - low)
            )
        y = effect.apply(x, dt, values, c)
        assert np.isfinite(y).all()
        changed |= not np.array_equal(y, x)
    assert changed


def test_effects_act_stage_by_stage_in_a_fixed_order():
    names = [
        e.name for e in in_order(["creep", "base_tilt", "valve_lag", "dead_time", "creep", "stiffening"])
    ]
    assert names == ["valve_lag", "dead_time", "stiffening", "creep", "base_tilt"]
    stages = [list(SIGNALS).index(e.stage) for e in EFFECTS]
    assert stages == sorted(stages)


def test_an_unknown_effect_is_refused_with_those_that_exist():
    with pytest.raises(InputError, match="valve_lag"):
        get_effect("valve_lagg")


@kernel
def _nothing(x, dt, theta, conditions, state):
    pass


def malformed(**fields):
    BodyEffect(name="a", parameters=(), run=_nothing, summary="", experiment="", **fields)


def test_a_malformed_effect_is_refused():
    with pytest.raises(InputError, match="stage 'muscle' must be one of pneumatics"):
        malformed(stage="muscle")
    with pytest.raises(InputError, match="signal 'joints'"):
        malformed(stage="drive", signal="joints")
    with pytest.raises(InputError, match="must lie in"):
        Parameter("a", "", 2.0, 0.0, 1.0)
    with pytest.raises(InputError, match="logarithmic"):
        Parameter("a", "", 0.5, 0.0, 1.0, log=True)
