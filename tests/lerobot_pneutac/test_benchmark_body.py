"""The table of body renderers: what is measured, what is left out, what is written."""

import json

import numpy as np
import pytest

from lerobot_pneutac import benchmark_body
from lerobot_pneutac.benchmark_body import BenchmarkBodyConfig, rmse, run, summary
from pneutac_sim.errors import InputError
from pneutac_sim.splat.rasteriser import Rendering


def test_error_counts_both_silhouettes_and_nothing_else():
    photograph = np.full((4, 4, 3), 200, np.uint8)
    mask = np.zeros((4, 4), bool)
    mask[0, :2] = True
    image, alpha = np.zeros((4, 4, 3)), np.zeros((4, 4))
    image[0, 1:3], alpha[0, 1:3] = 190 / 255, 1.0
    # missed: 200 levels; right but for 10 levels; drawn where there is nothing: 190 levels
    assert rmse(image, alpha, photograph, mask) == pytest.approx(np.sqrt((200**2 + 10**2 + 190**2) / 3))
    assert rmse(np.zeros_like(image), np.zeros_like(alpha), photograph, mask) == pytest.approx(200)


def test_means_leave_out_the_photograph_that_was_trained_on():
    def row(view, value, trained=False):
        return {"method": "a", "view": view, "trained": trained, "rmse": value, "fit_s": 1.0, "render_s": 0.1}

    (line,) = summary(
        [row("front", 0, True), row("front", 10), row("front", 14), row("back", 30), row("back", 30)]
    )
    assert line["front"] == 12 and line["front_sem"] == pytest.approx(2)
    assert line["back"] == 30 and line["back_sem"] == 0


def test_run_writes_table_pictures_and_result(tmp_path, monkeypatch):
    class Flat:
        """The trained photograph's silhouette in its mean colour, wherever the finger is."""

        def __init__(self, body, positions, gradients, image, mask, camera):
            self.drawn = Rendering(mask[..., None] * image[mask].mean(0) / 255, mask.astype(float))

        def image(self, positions, gradients, camera):
            return self.drawn

    ours = benchmark_body.methods(fast=True)["PneuTac"]
    monkeypatch.setattr(benchmark_body, "methods", lambda fast: {"flat": Flat, "PneuTac": ours})
    result = run(BenchmarkBodyConfig(out=tmp_path, bodies=1, step_kpa=15.0, particles=1500))
    assert json.loads((tmp_path / "result.json").read_text())["table"] == result["table"]
    assert (tmp_path / "pictures.png").is_file()
    assert "PneuTac" in (tmp_path / "table.md").read_text()
    flat, splats = result["table"]
    assert splats["front"] < 0.6 * flat["front"] and splats["back"] < 0.8 * flat["back"]
    assert sum(r["trained"] for r in result["rows"]) == 2
    assert len(result["rows"]) == 2 * 2 * 2  # methods, views, pressures


def test_bad_options_are_named():
    with pytest.raises(InputError, match="--step_kpa above 0"):
        BenchmarkBodyConfig(step_kpa=0)
    with pytest.raises(InputError, match="--bodies must be 1"):
        BenchmarkBodyConfig(bodies=0)
