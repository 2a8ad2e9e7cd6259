"""A finger whose bend grows by a known share between three dates."""

import json

import numpy as np
import pandas as pd
import pytest
from verbs import verb

from lerobot_pneutac.verbs.compare import ageing
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.finger import simulate
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin

NOISE_MM = 0.3


def bench(folder, day, grown=1.0, seed=0):
    """What the built-in finger does, its motion times `grown`, with noise."""
    rng = np.random.default_rng(seed)
    kpa = np.repeat(rng.uniform(0, 15, 60), 20)
    table = {"trial": np.repeat(range(4), 300), "time_s": np.tile(np.arange(300) / 10, 4)}
    table |= {"pressure_cmd_kpa": kpa, "tip_x_mm": 0 * kpa + 100, "tip_y_mm": 0 * kpa, "tip_z_mm": 0 * kpa}
    meta = {"length_mm": 110.0, "notes": ""} | ({"date": day} if day else {})
    recording = Recording(folder, meta, pd.DataFrame(table), "finger")
    names = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
    model = simulate(Twin.builtin(), BodyData.of(recording, Twin.builtin(), source="command")).model[:, :3]
    moved = model.mean(0) + grown * (model - model.mean(0)) + rng.normal(0, NOISE_MM, model.shape)
    recording.samples[names] = moved
    return Recording.load(recording.write(folder))


def test_a_finger_that_gives_way_is_found_and_the_day_of_its_next_calibration(tmp_path):
    grown = {"2026-01-01": 1.0, "2026-01-11": 1.003, "2026-01-31": 1.009}
    recordings = [bench(tmp_path / d, d, g, seed) for seed, (d, g) in enumerate(grown.items())]
    result = ageing(Twin.builtin(), recordings[::-1])
    assert [d.day.isoformat() for d in result.dates] == list(grown)
    slope, half = result.slope
    assert abs(slope - 0.0003) < half < 0.00015
    assert "more every 30 days" in result.sentence and "calibrate it again about" in result.sentence
    for d, g in zip(result.dates, grown.values(), strict=True):
        assert abs(d.bend - g) < 1.5 * d.half
    # sqrt(1.5^2 - 1) of the first error, over what a day's change moves.
    days = (result.again - result.dates[0].day).days
    first = result.dates[0]
    assert days == pytest.approx(1.25**0.5 * first.error / first.travel / slope, abs=1)


def test_one_that_stays_needs_no_calibration_and_one_far_off_needs_it_now(tmp_path):
    same = [bench(tmp_path / f"{k}", f"2026-01-{k:02d}", 1.0, k) for k in (1, 15)]
    steady = ageing(Twin.builtin(), same)
    assert steady.again is None and "no new calibration is due" in steady.sentence
    off = ageing(Twin.builtin(), [same[0], bench(tmp_path / "off", "2026-02-01", 1.1, 5)])
    assert off.again.isoformat() == "2026-02-01" and "calibrate it again now" in off.sentence


def test_the_command_writes_it_and_a_missing_date_is_one_sentence(tmp_path, capsys):
    Twin.builtin().save(tmp_path / "twin")
    for k in (1, 15):
        bench(tmp_path / f"{k}", f"2026-01-{k:02d}", 1.0, k)
    options = [f"--twin={tmp_path / 'twin'}", f"--recording={tmp_path / '1'}", f"--out={tmp_path / 'out'}"]
    verb("compare", *options, f"--later=[{tmp_path / '15'}]")
    assert "Ageing over 14 days" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert [d["date"] for d in result["dates"]] == ["2026-01-01", "2026-01-15"]
    assert result["calibrate_again"] is None and (tmp_path / "out" / "report.html").is_file()
    bench(tmp_path / "none", "")
    with pytest.raises(InputError, match="none/recording.json: field 'date' is missing; give the day"):
        verb("compare", *options[:2], f"--later=[{tmp_path / 'none'}]")
    meta = json.loads((tmp_path / "none" / "recording.json").read_text())
    meta["source"] = {"files": {"friday.csv": "0"}, "mapping": "0"}
    (tmp_path / "none" / "recording.json").write_text(json.dumps(meta))
    again = "friday.csv: the date is missing; give it, as by `pneutac convert .*friday.csv --mapping=.*date"
    with pytest.raises(InputError, match=again):
        verb("compare", *options[:2], f"--later=[{tmp_path / 'none'}]")
    with pytest.raises(InputError, match="two dates or more"):
        ageing(Twin.builtin(), [Recording.load(tmp_path / "1")])
