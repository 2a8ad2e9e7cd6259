"""The worked example of docs/how_to/add_an_effect.md, exactly as printed, installed beside the library."""

import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pneutac_sim.effects import all_effects
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, fit, simulate
from pneutac_sim.twin import Twin

DOC = Path(__file__).parents[3] / "docs" / "how_to" / "add_an_effect.md"


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", DOC.read_text(), re.S)


def install(folder, code, points):
    (folder / "pneutac_marker_offset.py").write_text(code)
    info = folder / "pneutac_marker_offset-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: pneutac-marker-offset\nVersion: 0.1.0\n")
    lines = ["[pneutac.effects]", *(f"{k} = {v}" for k, v in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture
def example(tmp_path, monkeypatch):
    project = tomllib.loads(blocks("toml")[0])["project"]
    install(tmp_path, blocks("python")[0], project["entry-points"]["pneutac.effects"])
    monkeypatch.syspath_prepend(tmp_path)
    all_effects.cache_clear()
    yield
    sys.modules.pop("pneutac_marker_offset", None)
    all_effects.cache_clear()


def test_it_is_under_forty_lines():
    assert len(blocks("python")[0].splitlines()) < 40


def test_it_is_found_last_in_its_stage_and_does_nothing_at_its_neutral_point(example):
    assert list(all_effects())[-1] == "marker_offset"
    effect = all_effects()["marker_offset"]
    x = np.random.default_rng(0).normal(size=(50, 5))
    np.testing.assert_array_equal(effect.apply(x, np.ones(50), {"beside_mm": 0.0}), x)


def test_it_is_fitted_like_any_other(example):
    n = 600
    table = {"trial": np.zeros(n, int), "time_s": np.arange(n) / 20}
    table["pressure_cmd_kpa"] = 7.5 * (1 - np.cos(table["time_s"] / 3))
    twin = Twin.builtin()
    empty = pd.DataFrame(table | {"tip_x_mm": np.zeros(n), "tip_z_mm": np.zeros(n)})
    recording = type("Recording", (), {"samples": empty, "device": "finger"})
    truth = twin.copy()
    truth.effects["marker_offset"] = all_effects()["marker_offset"].start(15.0)
    truth.effects["marker_offset"]["beside_mm"].value = 12.0
    seen = simulate(truth, BodyData.of(recording, truth)).model
    recording.samples[["tip_x_mm", "tip_z_mm"]] = seen + 0.1 * np.random.default_rng(0).normal(
        size=seen.shape
    )
    before, after = fit(twin, recording, []), fit(twin, recording, ["marker_offset"])
    assert before.train > 1.0 and after.train < 0.15
    low, high = after.ci95["marker_offset.beside_mm"]
    assert low <= 12.0 <= high


def test_a_second_effect_of_the_same_name_is_refused(tmp_path, monkeypatch):
    install(
        tmp_path, "from pneutac_sim.effects.creep import EFFECT\n", {"creep": "pneutac_marker_offset:EFFECT"}
    )
    monkeypatch.syspath_prepend(tmp_path)
    all_effects.cache_clear()
    try:
        with pytest.raises(InputError, match="effect named 'creep'"):
            all_effects()
    finally:
        sys.modules.pop("pneutac_marker_offset", None)
        all_effects.cache_clear()
