"""Whole recordings: repeatable, the same device on another day, readable, and of the promised size."""

import json
import subprocess
import sys

import numpy as np
import pytest

from pneutac_datasets.recording.recording import Recording
from pneutac_truths import EFFECTS, generate, write
from pneutac_truths.__main__ import main
from pneutac_truths.truth import changed, sized
from pneutac_truths.world import World

SHORT = {"minutes": 2.0}


@pytest.mark.slow
def test_the_same_seed_writes_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        sized.cache_clear()
        write(generate("rod", ["creep_fractional", "regulator_zero"], 3, **SHORT), tmp_path / name)
    for file in ("recording.json", "samples.csv", "truth.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_another_day_is_the_same_device_under_other_programs():
    one, two = (generate("rod", ["unfolding", "stretch"], 4, day=day, **SHORT) for day in (1, 2))
    assert one.effects == two.effects
    n = min(len(one.samples), len(two.samples))
    assert not np.array_equal(one.samples["pressure_cmd_kpa"][:n], two.samples["pressure_cmd_kpa"][:n])
    level = np.linspace(0.02, 0.98, 20) * one.top_kpa
    curves = []
    for truth in (one, two):
        p = truth.samples["pressure_cmd_kpa"].to_numpy()
        known, at = np.unique(p, return_index=True)
        assert known[-1] == pytest.approx(truth.top_kpa, rel=0.05)
        curves.append(np.interp(level, known, truth.pose[at, 2]))
    np.testing.assert_allclose(curves[0], curves[1], atol=0.3)


@pytest.mark.parametrize("device", ["rod", "arm"])
def test_a_plain_device_follows_the_command_at_once_and_without_memory(device):
    truth = generate(device, ["plain"], 2, **SHORT)
    columns = [c for c in truth.samples if c.startswith("pressure_cmd")]
    p = truth.samples[columns].to_numpy()
    _, first, same = np.unique(p, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_allclose(truth.pose, truth.pose[first][same.ravel()], atol=1e-9)
    noise = truth.samples[truth.observed].to_numpy() - truth.pose
    assert np.sqrt((noise**2).sum(1).mean()) == pytest.approx(truth.noise_floor, rel=0.05)


@pytest.mark.parametrize("device, curved", [("rod", False), ("arm", True)])
@pytest.mark.slow
def test_recordings_load_without_a_warning(tmp_path, device, curved):
    seed = 0 if curved else 2
    many = ["gravity", "payload", "temperature_drift", "gauge_late", "marker_slip"]
    truth = generate(device, many, seed, day=2, state_pauses=True, **SHORT)
    recording = Recording.load(write(truth, tmp_path / "r"))
    assert recording.warnings == []
    assert recording.observations == truth.observed
    assert ("curvature_x_1_per_m" in truth.observed) == curved
    assert recording.device == ("arm" if device == "arm" else "finger")
    trials = json.loads((tmp_path / "r" / "recording.json").read_text())["trials"]
    assert trials["0"] == {"start": "rested"} and trials["1"]["start"] == "continues"
    known = json.loads((tmp_path / "r" / "truth.json").read_text())
    assert {e["name"] for e in known["effects"] if not e["physics"]} == {"gauge_late", "marker_slip"}


def test_a_recording_of_ten_minutes_has_trials_pauses_and_repeats_as_a_lab_makes_them():
    w = World.start("rod", 7, 1, 10.0)
    p = w.plan
    assert 10 <= len(p.starts) <= 16
    lengths = (np.array(p.ends) - p.starts) * 0.005
    assert (lengths >= 15).all() and (lengths <= 60).all()
    assert lengths.sum() == pytest.approx(600, rel=0.1)
    assert all(2 <= x <= 60 for x in p.pauses_s[1:])
    trials = [p.command[a:b].tobytes() for a, b in zip(p.starts, p.ends, strict=True)]
    assert trials[-1] in trials[:-1]
    between = (np.flatnonzero(np.diff(p.command[:, 0])) + 1) % 10 != 0  # of steps that fall between samples
    assert between.mean() > 0.7
    assert (p.command[p.trial < 0] == 0).all()


def test_a_device_has_six_effects_that_are_physics():
    truth = generate("rod", ["device"], 5, **SHORT)
    assert len(truth.effects) == 6
    assert all(EFFECTS[name].physics for name in truth.effects)
    assert generate("rod", ["device"], 5, day=2, **SHORT).effects == truth.effects


@pytest.mark.parametrize("minutes", [0, -1, 1e9, float("nan")])
def test_a_length_of_no_recording_is_refused(minutes):
    with pytest.raises(ValueError, match="give more than 0 and at most 600"):
        generate("rod", ["plain"], 1, minutes=minutes)


@pytest.mark.parametrize(
    "device, effects, gauge, sentence",
    [
        ("rod", ["crep"], None, "no effect 'crep'"),
        ("rod", ["chamber_cross"], None, "applies to arm, not rod"),
        ("finger", ["plain"], None, "no device 'finger'"),
        ("rod", ["gauge_late"], False, "needs a gauge"),
    ],
)
def test_wrong_names_are_refused(device, effects, gauge, sentence):
    with pytest.raises(ValueError, match=sentence):
        generate(device, effects, 1, gauge=gauge)


def test_the_command_writes_a_new_folder_and_refuses_an_old_one(tmp_path, capsys):
    arguments = ["--effect=regulator_bow", "--seed=2", "--minutes=2", f"--out={tmp_path / 'r'}"]
    assert main(arguments) == 0
    assert (tmp_path / "r" / "samples.csv").is_file()
    with pytest.raises(SystemExit):
        main(arguments)
    assert "exists; name a new folder" in capsys.readouterr().err


def test_importing_needs_no_pyelastica_and_nothing_of_the_product():
    code = "import sys, pneutac_truths; print(*[m for m in sys.modules if '.' not in m])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    ours = {"elastica", "pneutac_sim", "pneutac_datasets", "lerobot_pneutac", "lerobot_robot_pneutac"}
    assert not ours & set(loaded.split())


@pytest.mark.nightly
@pytest.mark.parametrize(
    "device, seed", [("rod", 0), ("rod", 1), ("arm", 0), ("arm", 2), ("cosserat", 0), ("cosserat", 1)]
)
def test_each_effect_alone_moves_the_tip_by_3_to_12_times_the_noise(device, seed):
    outside = {}
    for name, effect in EFFECTS.items():
        if device not in effect.devices:
            continue
        parameters = dict(sized(device, name, seed))
        low, high = effect.ranges["size"]
        assert low <= parameters["size"] <= high, name
        for day in (1, 2):
            change = changed(device, name, seed, day, parameters)
            if not 3 <= change <= 12:
                outside[name, day] = change
    assert not outside


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["ringing", "overdamped", "fill_orifice", "obstacle"])
def test_what_is_sized_by_the_lowest_mode_holds_for_the_moving_rod(name):
    pytest.importorskip("elastica")
    plain, truth = (generate("cosserat", [n], 1) for n in ("plain", name))
    change = np.sqrt(((truth.pose - plain.pose) ** 2).sum(1).mean()) / truth.noise_floor
    assert 3 <= change <= 12
