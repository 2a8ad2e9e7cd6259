"""Hidden effects are there, are as large as asked for, are foreign, and keep their answer to themselves."""

import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import pneutac_datasets.generate.hidden as hidden
from pneutac_datasets.generate.hidden.generate import FULL_MISFIT, disturbance_names, effect_names, generate
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim import effects
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger import PressurePipeline
from pneutac_sim.twin import Twin

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
    assert truth["effects"] == [] and truth["verdict"] == "adequate" and truth["misfit_mm"] < 0.01
    assert misfit(r) == pytest.approx(truth["noise_floor_mm"], rel=0.03)
    assert noise_floor(r).value == pytest.approx(truth["noise_floor_mm"], rel=0.2)
    clean, warnings = check(r)
    assert warnings == [] and len(clean) == len(r)


@pytest.mark.parametrize("name", [*effect_names(), *disturbance_names()])
def test_a_full_effect_stands_well_above_the_noise(tmp_path, name):
    truth = generate(name, tmp_path / "r", seed=2, **QUICK)
    r = Recording.load(tmp_path / "r")
    assert truth["misfit_mm"] > 0.75 * FULL_MISFIT * truth["noise_floor_mm"]
    assert truth["details"][0]["form"]
    single_valued = {"gain_saturation", "stiffening", "camera_misalignment", "base_tilt"}
    if name in single_valued:  # a polynomial follows these, the paper's gain law does not
        assert misfit(r) < 2 * truth["noise_floor_mm"]
    else:
        assert misfit(r) > 1.8 * truth["noise_floor_mm"]


def test_strength_scales_the_misfit(tmp_path):
    errors = [
        generate("creep", tmp_path / str(s), seed=3, strength=s, **QUICK)["misfit_mm"]
        for s in (1.0, 0.5, 0.2)
    ]
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.15)
    assert errors[2] == pytest.approx(errors[0] / 5, rel=0.15)


def test_pairs_act_together(tmp_path):
    truth = generate(["creep", "valve_lag"], tmp_path / "r", seed=4, **QUICK)
    assert [d["name"] for d in truth["details"]] == ["creep", "valve_lag"]
    assert truth["misfit_mm"] > max(d["misfit_alone_mm"] for d in truth["details"])
    r = Recording.load(tmp_path / "r")
    lag = r.column("pressure_kpa") - r.column("pressure_cmd_kpa")
    assert np.abs(lag).max() > 0.1 * np.ptp(r.column("pressure_cmd_kpa"))


def test_equal_seeds_give_equal_files_and_others_do_not(tmp_path):
    for folder, seed in (("a", 7), ("b", 7), ("c", 8)):
        generate("hysteresis", tmp_path / folder, seed=seed, **QUICK)
    a, b, c = ((tmp_path / f / "samples.csv").read_bytes() for f in "abc")
    assert a == b != c


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
    assert {
        "stairs",
        "triangle_slow",
        "triangle_fast",
        "minor_loops",
        "long_hold",
        "random_steps",
        "cycles",
    } <= set(s["program"])
    assert s["temperature_c"].min() < 22 and s["temperature_c"].max() > 29
    assert set(s["payload_g"]) == {0, 50}
    g = s[["gravity_x", "gravity_y", "gravity_z"]].drop_duplicates().to_numpy()
    np.testing.assert_array_equal(g[0], -g[1])
    for column, part in (("program", s["program"]), ("gravity", s["gravity_x"] + s["gravity_z"])):
        train, heldout = r.split(0)
        assert set(part[train]) == set(part[heldout]), column


@pytest.mark.slow
def test_no_effect_of_the_library_takes_part(tmp_path):
    """Watched while every hidden effect is generated: nothing of the library's effects is even entered.

    Compiled functions leave no trace of their calls, so none may be within reach of the generator's modules.
    """
    library = str(Path(effects.__file__).parent)
    entered = set()

    def watch(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(library):
            entered.add(frame.f_code.co_qualname)

    for name in [*effect_names(), *disturbance_names()]:
        sys.setprofile(watch)
        try:
            generate(name, tmp_path / name, seed=1, minutes=1.0, hz=10.0)
        finally:
            sys.setprofile(None)
    assert entered == set()
    own = [m for n, m in sys.modules.items() if n.startswith(f"{hidden.__name__}.")]
    assert len(own) >= 8
    for module in own:
        for name, thing in vars(module).items():
            home = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None)
            assert not str(home).startswith(effects.__name__), f"{module.__name__}.{name}"


def test_the_watch_sees_a_library_effect(tmp_path):
    """Else the test above could not fail."""
    entered = set()
    sys.setprofile(lambda frame, event, _: entered.add(frame.f_code.co_filename))
    try:
        PressurePipeline(Twin("finger", effects={"creep": get_effect("creep").start(15.0)})).step(5.0, 0.1)
    finally:
        sys.setprofile(None)
    assert any(f.startswith(str(Path(effects.__file__).parent)) for f in entered)


@pytest.mark.parametrize(("option", "value"), [("strength", 0.0), ("minutes", 0.1), ("hz", 1000.0)])
def test_numbers_out_of_range_are_refused(tmp_path, option, value):
    with pytest.raises(InputError, match=option):
        generate("none", tmp_path / "r", **{option: value})
