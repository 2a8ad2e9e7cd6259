"""Hidden effects are there, are as large as asked for, and keep their answer to themselves."""

import json

import numpy as np
import pytest

from pneutac_datasets.generate.finger import TRUTHS, generate
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import body_effects
from pneutac_sim.errors import InputError
from pneutac_truths.truth import FULL

QUICK = {"minutes": 2.0, "hz": 20.0}


def misfit(recording):
    """Error, mm, of the best polynomial from pressure to tip: what no memoryless curve explains."""
    p = recording.column("pressure_cmd_kpa")
    u = p / np.ptp(p)
    basis = np.stack([u**k for k in range(7)], 1)
    y = recording.samples[["tip_x_mm", "tip_y_mm", "tip_z_mm"]].to_numpy()
    left = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
    return float(np.sqrt((left**2).sum(1).mean()))


def test_none_is_a_memoryless_curve_and_noise(tmp_path):
    truth = generate("none", tmp_path / "r", seed=5, **QUICK)
    r = Recording.load(tmp_path / "r")
    assert truth["effects"] == [] and truth["verdict"] == "adequate"
    assert misfit(r) == pytest.approx(truth["noise_floor_mm"], rel=0.03)
    assert noise_floor(r).value == pytest.approx(truth["noise_floor_mm"], rel=0.2)
    clean, warnings = check(r)
    assert warnings == [] and len(clean) == len(r)


def test_every_effect_of_a_finger_has_a_simulation():
    assert {n for n in TRUTHS if not n.startswith("disturbance_")} <= set(body_effects())


@pytest.mark.parametrize("name", TRUTHS)
def test_a_full_effect_stands_well_above_the_noise(tmp_path, name):
    truth = generate(name, tmp_path / "r", seed=2, **QUICK)
    r = Recording.load(tmp_path / "r")
    assert truth["details"][0]["form"] and truth["details"][0]["simulation"] == TRUTHS[name]
    assert truth["verdict"] == ("unknown_effect" if name.startswith("disturbance_") else "missing_effect")
    single_valued = {"gain_saturation", "stiffening", "camera_misalignment", "base_tilt"}
    if name in single_valued:  # a polynomial follows these
        assert misfit(r) < 2 * truth["noise_floor_mm"]
    elif name == "sensor_offset":  # the gauge alone is off
        off = r.column("pressure_kpa") - r.column("pressure_cmd_kpa")
        assert np.sqrt(np.mean(off**2)) > 0.03 * np.ptp(r.column("pressure_cmd_kpa"))
    else:
        assert misfit(r) > 1.8 * truth["noise_floor_mm"]


@pytest.mark.parametrize("name", ["creep", "gravity"])
def test_strength_scales_the_misfit(tmp_path, name):
    left = []
    for s in (1.0, 0.5, 0.2):
        noise = generate(name, tmp_path / str(s), seed=3, strength=s, **QUICK)["noise_floor_mm"]
        left.append(np.sqrt(misfit(Recording.load(tmp_path / str(s))) ** 2 - noise**2) / noise)
    assert left[0] == pytest.approx(FULL, rel=0.2)
    assert left[1] == pytest.approx(left[0] / 2, rel=0.15)
    assert left[2] == pytest.approx(left[0] / 5, rel=0.15)


def test_pairs_act_together(tmp_path):
    truth = generate(["creep", "valve_lag"], tmp_path / "r", seed=4, **QUICK)
    assert [d["name"] for d in truth["details"]] == ["creep", "valve_lag"]
    alone = []
    for name in truth["effects"]:
        generate(name, tmp_path / name, seed=4, **QUICK)
        alone.append(misfit(Recording.load(tmp_path / name)))
    r = Recording.load(tmp_path / "r")
    assert misfit(r) > max(alone)
    lag = r.column("pressure_kpa") - r.column("pressure_cmd_kpa")
    assert np.abs(lag).max() > 0.1 * np.ptp(r.column("pressure_cmd_kpa"))


def test_the_answer_is_not_in_the_recordings_folder(tmp_path):
    generate("gravity", tmp_path / "r", seed=1, **QUICK)
    assert sorted(p.name for p in (tmp_path / "r").iterdir()) == ["recording.json", "samples.csv"]
    assert "gravity" not in (tmp_path / "r" / "recording.json").read_text()
    other = generate("none", tmp_path / "s", seed=1, **QUICK)
    a, b = (Recording.load(tmp_path / f) for f in "rs")
    assert a.meta == b.meta and list(a.samples) == list(b.samples)
    assert json.loads((tmp_path / "truth" / "r.json").read_text())["effects"] == ["gravity"]
    assert json.loads((tmp_path / "truth" / "s.json").read_text()) == other


def test_the_session_has_every_program_and_condition(tmp_path):
    generate("none", tmp_path / "r", seed=6)
    r = Recording.load(tmp_path / "r")
    s = r.samples
    assert s["time_s"].groupby(s["trial"]).max().sum() == pytest.approx(600, rel=0.15)
    programs = "stairs triangle_slow triangle_fast minor_loops long_hold random_steps cycles"
    assert set(programs.split()) <= set(s["program"])
    assert s["temperature_c"].min() < 22 and s["temperature_c"].max() > 29
    assert set(s["payload_g"]) == {0, 50}
    g = s[["gravity_x", "gravity_y", "gravity_z"]].drop_duplicates().to_numpy()
    np.testing.assert_array_equal(g[0], -g[1])
    for column, part in (("program", s["program"]), ("gravity", s["gravity_x"] + s["gravity_z"])):
        train, heldout = r.split(0)
        assert set(part[train]) == set(part[heldout]), column


@pytest.mark.parametrize("hz", [5.0, 30.0, 100.0])
def test_samples_come_at_the_pace_that_was_asked_for(tmp_path, hz):
    generate("marker_slip", tmp_path / "r", seed=1, minutes=1.0, hz=hz)
    r = Recording.load(tmp_path / "r")
    time_s = r.column("time_s")[r.trials()[0]]
    np.testing.assert_allclose(time_s, np.arange(len(time_s)) / hz, atol=0.0026)


@pytest.mark.parametrize(("option", "value"), [("strength", 0.0), ("minutes", 0.1), ("hz", 1000.0)])
def test_numbers_out_of_range_are_refused(tmp_path, option, value):
    with pytest.raises(InputError, match=option):
        generate("none", tmp_path / "r", **{option: value})


def test_a_gauges_fault_without_a_gauge_is_refused(tmp_path):
    with pytest.raises(InputError, match="gauge_drifting' needs a gauge"):
        generate("sensor_offset", tmp_path / "r", measured_pressure=False, **QUICK)
    assert not (tmp_path / "r").exists()
