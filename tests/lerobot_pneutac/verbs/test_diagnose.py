"""`pneutac diagnose` end to end on generated recordings: what it writes, finds and repeats."""

import json

import numpy as np
import pytest
from generated import twin_of

from lerobot_pneutac.cli import diagnose as verb
from lerobot_pneutac.diagnosis import engine
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.profile import profile
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from lerobot_pneutac.reports.sentences import percent
from lerobot_pneutac.verbs.diagnose import diagnose
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow


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
