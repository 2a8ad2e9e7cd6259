"""`pneutac diagnose` end to end on generated recordings: what it writes, finds and repeats."""

import numpy as np
import pytest
from generated import twin_of

from lerobot_pneutac import add
from lerobot_pneutac.verbs.diagnose import diagnose
from pneutac_sim.effects.laws import family
from pneutac_sim.finger import simulate
from pneutac_sim.twin import Twin, Value

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def creep(bench):
    """What is found where creep is hidden."""
    recording = bench("creep", seed=5003)
    return diagnose(twin_of(recording), recording, jobs=1)


def test_hidden_creep_is_found_down_to_the_noise(creep):
    assert creep.verdict in ("missing_effect", "insufficient_form")
    assert family(creep.selected[0]) == "creep"
    assert creep.outcome.evidence.after < 1.15 < 3 < creep.outcome.evidence.before
    assert creep.explained == "fully" and creep.outcome.evidence.forward


def test_laws_that_cancel_each_other_are_seen(creep):
    """Two equal laws of opposite sign change no prediction, so no error tells of them."""
    from dataclasses import replace

    from lerobot_pneutac.diagnosis.result import FittedModel
    from lerobot_pneutac.study.body import _cancelling

    def constants(weight):
        return {"weight": Value(weight), "scale_kpa": Value(15.0), "time_s": Value(8.0)}

    twin, study = creep.outcome.after.twin, creep.study
    for weight, expected in ((0.05, []), (30.0, ["lag(p)", "lag(p) #2"])):
        both = {"lag(p)": constants(weight), "lag(p) #2": constants(-weight)}
        other = replace(twin, effects=both)
        model = FittedModel(effects=tuple(both), residual=study.residual(other), count=2, twin=other)
        assert _cancelling(study, model, list(both)) == expected


def test_the_report_shows_what_was_found(creep, tmp_path):
    html = creep.report(tmp_path).read_text()
    assert "How well each parameter is known" in html and "Your finger" in html
    assert all(name.replace("&", "&amp;") in html for name in creep.selected)
    assert "http" not in html.split("<main>")[1].split("<script")[0]


def test_what_is_wrong_with_the_recording_is_always_on_the_console(creep):
    from dataclasses import replace

    told = replace(creep)
    vars(told)["state"] = replace(
        creep.state, objections=("a", "b", "c", "d"), notes=("The sensor saturates.",)
    )
    lines = told.remarks()
    assert "- A check failed: c." in lines and "- A check failed: d." not in lines
    assert lines[4] == "- The sensor saturates." and "more in the report" in lines[5]


def test_the_found_twin_is_what_was_measured_against(creep, tmp_path):
    """It is saved and read again, and predicts as the search said."""
    twin = Twin.load(creep.outcome.twin.save(tmp_path / "twin"))
    test = creep.study.parts.test
    assert simulate(twin, creep.study.recording).data.unit == creep.study.unit
    residual = creep.study.residual(twin)
    error = np.sqrt((residual[test] ** 2).sum(axis=1).mean())
    assert error == pytest.approx(creep.after["heldout"], rel=0.02)


def test_a_finding_is_added_whole(creep, tmp_path):
    recording = creep.study.recording
    result = add(twin_of(recording), recording, creep)
    assert result.accepted and set(creep.selected) <= set(result.twin.effects)
    assert result.after["heldout"] == pytest.approx(creep.after["heldout"])
    version = Twin.load(result.save(twin_of(recording).save(tmp_path / "twin")).saved_to)
    assert version.effects == result.twin.effects
    assert version.history[-1]["change"] == f"added {', '.join(creep.selected)}"


def test_headline_and_verdict_rest_on_test_blocks_alone(creep):
    """What fits and choices have seen is too good to be told."""
    parts, evidence, floor = creep.study.parts, creep.outcome.evidence, creep.study.noise.value
    assert parts.has_test and not (parts.test & parts.train).any()
    for model, error in ((creep.outcome.before, creep.before), (creep.outcome.after, creep.after)):
        squared = (model.residual**2).sum(1)
        assert error["heldout"] == pytest.approx(np.sqrt(squared[parts.test].mean()))
    assert evidence.after == pytest.approx(creep.after["heldout"] / floor)


def test_nothing_missing_is_adequate_again_and_again_whatever_the_threads(bench):
    recording = bench("none")
    a, b = (diagnose(twin_of(recording), recording, jobs=jobs, seed=3).outcome for jobs in (1, 2))
    assert a.verdict == b.verdict == "adequate" and a.selected == [] and a.evidence == b.evidence
    assert a.evidence.before < 1.15
    np.testing.assert_array_equal(a.after.residual, b.after.residual)
