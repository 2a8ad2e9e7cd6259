"""`pneutac diagnose` end to end on generated recordings, and its honesty on poor ones."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from generated import once

from lerobot_pneutac.cli import diagnose as verb
from lerobot_pneutac.diagnosis import engine
from lerobot_pneutac.diagnosis.experiment import separations
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.profile import profile
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from lerobot_pneutac.reports.sentences import percent
from lerobot_pneutac.study.pair import same_body
from lerobot_pneutac.verbs.diagnose import diagnose
from pneutac_datasets.generate.hidden.generate import generate
from pneutac_datasets.recording.mounts import align_mounts
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value

SEED = 5001


def twin_of(recording):
    return Twin(recording.device, recording.length_mm, recording.spine_joint_positions_mm)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Makes a short hidden recording once for each effect."""
    folder = tmp_path_factory.mktemp("hidden")

    def make(effect, seed=SEED, minutes=3.0):
        path = folder / f"{effect}_{seed}"
        if not path.is_dir():
            once(generate, [effect], path, seed, minutes=minutes, hz=10)
        return Recording.load(path)

    return make


def test_the_verb_writes_contract_and_report(bench, tmp_path, capsys):
    recording = bench("creep")
    twin = twin_of(recording).save(tmp_path / "twin")
    before = (twin / "twin.yaml").read_text()
    verb.main([f"--twin={twin}", f"--recording={recording.folder}", f"--out={tmp_path / 'out'}", "--jobs=1"])
    assert (twin / "twin.yaml").read_text() == before
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["verdict"] in ("missing_effect", "insufficient_form") and result["selected"][0] == "creep"
    assert result["after"]["heldout"] < 0.5 * result["baseline"]["heldout"]
    mine = next(e for e in result["effects"] if e["name"] == "creep")
    lo, hi = mine["reduction_ci95"]
    assert 0.8 < lo <= mine["reduction"] <= hi <= 1.0
    assert {p["parameter"].partition(".")[0] for p in result["profile"]} == set(result["selected"])
    for p in result["profile"]:
        assert p["interval95"][0] <= p["value"] <= p["interval95"][1]
        assert bool(p["remark"]) == (not (p["bounded_below"] and p["bounded_above"]))
    assert result["ladder"][-1]["heldout"] == pytest.approx(result["after"]["heldout"])
    html = (tmp_path / "out" / "report.html").read_text()
    assert "How well each parameter is known" in html
    assert "Your finger creeps" in html and "http" not in html.split("<main>")[1].split("<script")[0]
    assert "Your finger creeps" in " ".join(capsys.readouterr().out.split())


def test_headline_and_verdict_rest_on_test_blocks_alone(bench):
    """Validation blocks chose the effects, so an error on them is too good."""
    recording = bench("creep")
    d = diagnose(twin_of(recording), recording, jobs=1)
    parts, evidence, floor = d.study.parts, d.outcome.evidence, d.study.noise.value
    assert not (parts.test & parts.validation).any() and not (parts.test & parts.train).any()
    for model, error, ratio in (
        (d.outcome.before, d.before, evidence.before),
        (d.outcome.after, d.after, evidence.after),
    ):
        squared = (model.residual**2).sum(1)
        expected = np.sqrt(squared[parts.test].mean())
        assert error["heldout"] == pytest.approx(expected) and ratio == pytest.approx(expected / floor)
    assert evidence.removed == d.reduction[0]


def test_nothing_missing_is_adequate(bench):
    recording = bench("none")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.verdict == "adequate" and d.selected == []
    assert d.outcome.evidence.before < 1.15


def test_measured_pressure_tells_the_valve_from_the_body(bench):
    recording = bench("valve_lag")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.selected[0] in ("valve_lag", "orifice_flow") and d.study.measured
    assert "creep" not in d.selected
    assert d.outcome.pressure_error[1] < 0.5 * d.outcome.pressure_error[0]
    assert d.after["heldout"] < 0.6 * d.before["heldout"]


def test_a_disturbance_is_unknown_and_no_headline(bench):
    recording = bench("disturbance_base_bumps")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.verdict == "unknown_effect"
    assert "no known effect" in d.sentence


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["hysteresis", "gravity", "leak", "cyclic_softening"])
def test_hidden_effects_are_named_blindly(bench, effect):
    recording = bench(effect, minutes=10.0, seed=5002)
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.verdict in ("missing_effect", "insufficient_form") and d.selected[0] == effect
    assert d.reduction[0] > 0.8


def test_a_diagnosis_repeats_itself(bench):
    recording = bench("none")
    a, b = (diagnose(twin_of(recording), recording, jobs=1, seed=3).outcome for _ in range(2))
    assert a.verdict == b.verdict and a.evidence == b.evidence
    assert np.array_equal(a.after.residual, b.after.residual)


def test_workers_give_the_same_answer(bench, monkeypatch):
    recording = bench("creep")
    twin, parts = twin_of(recording), deal(recording, 0)
    sets = [(), ("creep",), ("stiffening",), ("valve_lag",)]
    jobs = [engine.Job(twin, e, "pose", "command", 2) for e in sets]
    found, profiles = [], []
    for processes in (1, 2):
        monkeypatch.setattr(engine, "PATIENCE_S", 0.0)
        with engine.Engine(recording, parts.train, processes) as e:
            found.append(e.run(jobs))
            assert (e._pool is not None) == (processes == 2)
            fitter, creep = engine.StageFitter(e, twin, "pose", "command"), found[0][1]
            profiles.append(profile(fitter, creep, ["creep"], parts, Steps()))
    for a, b in zip(*profiles, strict=True):
        np.testing.assert_allclose(a.interval, b.interval, rtol=1e-6)
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a.residual, b.residual, rtol=0, atol=1e-9)
        assert a.effects == b.effects


def test_a_short_recording_is_ambiguous_and_says_what_to_record(bench):
    recording = bench("creep")
    short = recording.keep(np.arange(len(recording)) < 40)
    d = diagnose(twin_of(recording), short, jobs=1)
    assert d.verdict == "ambiguous"
    assert "too short" in d.sentence and "ten minutes" in d.next_experiment


def test_constant_pressure_is_ambiguous(bench):
    recording = bench("none")
    still = recording.keep(np.arange(len(recording)) < 600)
    still.samples["pressure_cmd_kpa"] = 20.0
    still.samples["pressure_kpa"] = 20.0
    d = diagnose(twin_of(recording), still, jobs=1)
    assert d.verdict == "ambiguous" and "the commanded pressure never moves" in d.sentence
    assert "does not move either" in d.study.caveats(d.outcome)[0] and "ten minutes" in d.next_experiment
    still.samples["pressure_kpa"] = recording.samples["pressure_kpa"][:600]
    d = diagnose(twin_of(recording), still, jobs=1)
    assert d.verdict == "ambiguous"
    said = " ".join([d.sentence, *d.study.caveats(d.outcome)])
    assert "the commanded pressure never moves" in said and "measured pressure moves" in said
    assert "not measured" not in said


def test_too_few_rows_to_fit_name_the_file_and_what_to_record(bench, tmp_path):
    recording = bench("none")
    recording.keep(np.arange(len(recording)) < 3).write(tmp_path / "three")
    twin = twin_of(recording).save(tmp_path / "twin")
    wanted = r"three/samples\.csv has 3 rows, .* at least \d+ .*; record ten minutes with steps"
    with pytest.raises(InputError, match=wanted) as e:
        verb.main([f"--twin={twin}", f"--recording={tmp_path / 'three'}"])
    least = int(re.search(r"at least (\d+)", str(e.value))[1])
    d = diagnose(twin_of(recording), recording.keep(np.arange(len(recording)) < least), jobs=1)
    assert d.verdict == "ambiguous"


def test_pressures_far_above_the_calibrated_are_noted(bench, tmp_path):
    recording = bench("none")
    twin = twin_of(recording)
    twin.parameters = {"gain_rad_per_kpa": Value(0.01, (0.009, 0.011))}
    twin.save(tmp_path / "twin")
    for factor, noted in ((1.0, False), (40.0, True)):
        other = recording.keep(np.ones(len(recording), bool))
        other.samples[["pressure_cmd_kpa", "pressure_kpa"]] *= factor
        folder = other.write(tmp_path / f"times_{factor:g}")
        warnings = same_body(twin, Recording.load(folder), "diagnose").warnings
        assert any("pascal" in w for w in warnings) == noted


def test_effects_without_their_column_are_listed_with_the_remedy(bench):
    recording = bench("none")
    poor = Recording(
        recording.folder, recording.meta, recording.samples.drop(columns=["temperature_c"]), "finger"
    )
    d = diagnose(twin_of(recording), poor, jobs=1)
    assert "record column temperature_c" in next(u.reason for u in d.study.untested if u.name == "thermal")


def test_wrong_device_and_missing_options_are_one_sentence(bench, tmp_path):
    recording = bench("none")
    twin = Twin("arm", recording.length_mm).save(tmp_path / "arm")
    with pytest.raises(InputError, match="of a finger and .* of an arm; diagnose"):
        verb.main([f"--twin={twin}", f"--recording={recording.folder}"])
    with pytest.raises(InputError, match="--twin=DIR"):
        verb.main([f"--recording={recording.folder}"])


def test_percentages_have_no_minus_zero_and_no_empty_interval():
    assert percent(-0.001, (-0.004, 0.3)) == "0 % [0 to 30]"
    assert percent(0.999, (0.998, 1.0)) == "100 %"


def test_verdicts_follow_the_evidence():
    def evidence(**change):
        base = {
            "samples": 5000, "units": 20, "moves": True, "before": 5.0, "after": 1.0, "limit": 1.06,
            "selected": ["creep"], "removed": 0.99, "at_bound": [], "near_miss": [],
        }  # fmt: skip
        return decide(Evidence(**(base | change)))

    assert evidence() == "missing_effect"
    assert evidence(before=1.03, selected=[]) == "adequate"
    assert evidence(selected=[]) == "unknown_effect"
    assert evidence(selected=[], near_miss=["creep"]) == "ambiguous"
    assert evidence(after=2.5, removed=0.8) == "insufficient_form"
    assert evidence(after=4.0, removed=0.3) == "unknown_effect"
    assert evidence(units=3) == "ambiguous"


def test_the_proposed_experiment_separates_the_rivals(bench):
    """Stiffening and saturation agree where they were fitted and part above it."""
    recording = bench("none")
    top = recording.column("pressure_cmd_kpa").max()
    twin = twin_of(recording)
    twin.parameters = {
        "gain_rad_per_kpa": Value(0.006), "gain_alpha": Value(0.0), "gain_beta": Value(0.2),
        "rest_pressure_kpa": Value(5.0), "joint_stiffness_nm_per_rad": Value(0.458),
    }  # fmt: skip
    a, b = twin.copy(), twin.copy()
    a.effects = {"gain_saturation": {"saturation_pressure_kpa": Value(1.2 * top)}}
    b.effects = {
        "stiffening": {
            "linear_1_per_kpa": Value(0.0),
            "quadratic_1_per_kpa2": Value(-1 / (3 * (1.2 * top) ** 2)),  # tanh to third order
        }
    }
    found = separations(recording, a, b, 0.5, ("gain_saturation", "stiffening"))
    assert found[0].name == "higher" and found[0].score > 3 * np.median([s.score for s in found])


def test_measuring_pressure_is_proposed_for_lag_against_creep(bench):
    recording = bench("none")
    blind = Recording(
        recording.folder, recording.meta, recording.samples.drop(columns=["pressure_kpa"]), "finger"
    )
    a, b = twin_of(recording), twin_of(recording)
    a.effects = {"valve_lag": {"fill_time_s": Value(0.5), "vent_time_s": Value(0.8)}}
    b.effects = {"creep": {}}
    found = separations(blind, a, b, 0.5, ("valve_lag", "creep"))
    assert found[0].name.startswith("log the measured pressure")


def test_trials_of_another_mount_are_moved_onto_the_first(bench):
    recording = bench("none")
    trials = list(recording.trials().values())
    turned = Recording(recording.folder, recording.meta, recording.samples.copy(), "finger")
    rows = turned.samples.index[trials[1]]
    turned.samples.loc[rows, ["tip_y_mm", "tip_z_mm"]] *= -1
    turned.samples.loc[rows, "tip_x_mm"] += 20.0
    back, said, alike = align_mounts(turned, recording.length_mm)
    assert len(said) == 1 and "trial 1" in said[0] and alike[:2] == [0, 1]
    tip = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
    moved = back.samples[tip].to_numpy()[trials[1]] - recording.samples[tip].to_numpy()[trials[1]]
    assert np.abs(moved).max() < 10.0  # a straight line through a curved answer places the rest that well
    assert align_mounts(recording, recording.length_mm)[1] == []


def real(name):
    root = os.environ.get("PNEUTAC_DATA")
    if not root or not (Path(root) / "soft" / name).is_dir():
        pytest.skip("PNEUTAC_DATA is unset: no real recordings here")
    return Recording.load(Path(root) / "soft" / name)


@pytest.mark.slow
def test_real_segment_stiffens():
    recording = real("sopra_segment")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert "stiffening" in d.selected and d.after["heldout"] < 0.5 * d.before["heldout"]


@pytest.fixture(scope="module")
def fabric_segment():
    recording = real("asu_segment")
    return diagnose(Twin("finger", recording.length_mm), recording)


@pytest.mark.slow
def test_real_segment_lag_and_creep_are_told_apart(fabric_segment):
    d = fabric_segment
    assert {"valve_lag", "orifice_flow"} & set(d.selected) and "creep" in d.selected
    assert d.outcome.pressure_error[1] < 0.5 * d.outcome.pressure_error[0]  # the air by itself
    assert d.reduction[1][0] > 0  # the whole interval: the error surely falls


@pytest.mark.slow
def test_real_segment_error_is_halved(fabric_segment):
    assert fabric_segment.after_error < 0.5 * fabric_segment.before_error
