import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from generated import once
from verbs import refused, verb

from lerobot_pneutac.diagnosis.search import Steps
from lerobot_pneutac.diagnosis.thresholds import APART, FOLDS, NEEDED
from lerobot_pneutac.study import gel as gel_study
from lerobot_pneutac.study.gel import GelStudy, deal_photographs, photograph_folds, predict
from pneutac_datasets.generate.gel import NOISE_LEVELS, SIZES, write_gel_recording, write_hidden_gel
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects import get_effect
from pneutac_sim.gel.fit import GelFit
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow


def linear_twin(folder, recording):
    """The paper's linear model of a recording's sensor."""
    verb("calibrate", twin=folder, recording=recording.folder, effects="none")
    return folder


def run(name, out, twin, recording, *more):
    verb(name, *more, twin=twin, recording=recording.folder, out=out)
    return json.loads((out / "result.json").read_text())


@pytest.mark.nightly  # one to two minutes each; golden results hold one for every day
@pytest.mark.parametrize("effect", SIZES)
def test_a_hidden_effect_is_named_added_and_lowers_the_error(effect, tmp_path, capsys):
    recording = once(write_hidden_gel, tmp_path / "recording", [effect], seed=3, images=16)
    twin = linear_twin(tmp_path / "twin", recording)
    found = run("diagnose", tmp_path / "d", twin, recording)
    assert found["selected"] == [effect] and found["verdict"] == "missing_effect"
    assert found["reduction"] > 0.9 and found["after"]["heldout"] < 1.1 * found["noise_floor"]
    truth = json.loads((tmp_path / "truth" / "recording.json").read_text())[effect]
    fitted = found["parameters"][effect]
    beside = {k: v for k, v in fitted.items() if k.startswith(("along", "across", "deep"))}
    assert all(abs(v) < 15 for v in beside.values()), "terms that the truth does without stay small"
    kept = {k: v for k, v in fitted.items() if "edge" not in k and k not in beside}
    neutral = {"shift": 0.0, "turn": 0.0, "drift": 0.0, "scale": 1.0, "gain": 1.0}
    for name, value in kept.items():
        at = neutral.get(name.split("_")[0], 0.0)
        assert value - at == pytest.approx(truth[name] - at, rel=0.35, abs=0.02), name
    page = (tmp_path / "d" / "report.html").read_text()
    assert (
        "image/png;base64" in page and f"pneutac add --twin={twin}" in page and f"--effect={effect}" in page
    )

    before = run("compare", tmp_path / "c1", twin, recording)["error"]["heldout"]
    added = run("add", tmp_path / "a", twin, recording, f"--effect={effect}")
    assert added["after"]["heldout"] < added["before"]["heldout"] and added["version"] == 1
    after = run("compare", tmp_path / "c2", twin, recording)["error"]["heldout"]
    left, excess = after - NOISE_LEVELS, before - NOISE_LEVELS  # no model predicts the camera's noise
    assert left < 0.3 * excess, "the stored twin predicts better"
    assert list(Twin.load(twin).effects) == [effect]
    capsys.readouterr()


def test_a_diagnosis_and_a_comparison_predict_the_same_images(tmp_path):
    """Both know the drift of light of every calibration press."""
    recording = write_gel_recording(tmp_path / "recording", seed=1, heldout=2)
    recording.samples.loc[:1, "role"] = "calibration"
    recording.write(tmp_path / "recording")
    study = GelStudy(Twin(device="gel"), Recording.load(tmp_path / "recording"))
    gel = replace(study.space.gel, light=GelModel.builtin().light)
    differences = study.space.differences([gel] * len(study.data.samples))
    predicted = [s.image + d for s, d in zip(study.data.samples, differences, strict=True)]
    np.testing.assert_array_equal(predicted, predict(gel, study.data))


def test_an_effect_is_idle_where_it_moves_no_image(tmp_path):
    """A fit with it is then better for having searched longer alone, and it is not added."""
    recording = write_gel_recording(tmp_path / "recording", seed=1, heldout=2)
    study = GelStudy(Twin(device="gel"), recording)
    neutral = {p.name: p.neutral for p in get_effect("registration_shift").parameters}
    for shift_mm in (0.0, 0.5):
        effects = {"registration_shift": neutral | {"shift_x_mm": shift_mm}}
        gel = replace(study.space.gel, light=GelModel.builtin().light, effects=effects)
        model = SimpleNamespace(fit=GelFit(gel, 0.0, 1))
        assert study.idle(model, "registration_shift") == (shift_mm == 0)


@pytest.mark.nightly  # every day: a search on five photographs, below
def test_nothing_is_found_where_nothing_is_hidden(tmp_path, capsys):
    recording = once(write_hidden_gel, tmp_path / "recording", [], seed=4, images=NEEDED)
    twin = linear_twin(tmp_path / "twin", recording)
    found = run("diagnose", tmp_path / "d", twin, recording)
    assert found["selected"] == [] and found["verdict"] == "adequate"
    refused("Not added", "add", twin=twin, recording=recording.folder, effect="shadow")
    assert Twin.load(twin).effects == {} and len(Twin.load(twin).history) == 1
    assert "Nothing is missing" in capsys.readouterr().out


@pytest.mark.nightly
def test_too_few_images_are_no_verdict_and_the_sentence_says_how_many_it_takes(tmp_path, capsys):
    recording = once(write_hidden_gel, tmp_path / "recording", ["shadow"], images=5)
    found = run("diagnose", tmp_path / "d", linear_twin(tmp_path / "twin", recording), recording)
    assert found["verdict"] == "ambiguous"
    assert "it has 5 images" in found["sentence"] and f"{NEEDED} are needed" in found["sentence"]
    assert "usable for the test" in " ".join(capsys.readouterr().out.split())


def test_to_what_cannot_be_diagnosed_nothing_is_added(tmp_path):
    recording = once(write_hidden_gel, tmp_path / "recording", ["shadow"], images=NEEDED - 1)
    twin = linear_twin(tmp_path / "twin", recording)
    refused(f"it has {NEEDED - 1} images", "add", twin=twin, recording=recording.folder, effect="shadow")
    assert Twin.load(twin).effects == {}


def many(recording):
    """The same photographs several times over, without the calibration pair's copies."""
    samples = recording.samples.loc[[0, *np.repeat(np.arange(1, len(recording)), 3)]].reset_index(drop=True)
    return replace(recording, samples=samples)


def test_few_photographs_are_judged_by_cross_validation_and_of_many_a_third_is_kept_apart(tmp_path):
    recording = once(write_hidden_gel, tmp_path / "recording", [], images=NEEDED)
    few = deal_photographs(recording, 0)
    assert few.train.all() and not few.has_test and few.test.sum() == NEEDED - 1
    fold = photograph_folds(few, 0)
    assert fold[0] == -1, "the calibration pair always trains"
    assert set(fold[1:]) == set(range(FOLDS)) and np.ptp(np.bincount(fold[1:])) <= 1
    enough = many(recording)
    assert len(enough) >= APART
    parts = deal_photographs(enough, 0)
    assert parts.has_test and (parts.train ^ parts.test).all() and parts.train[0]
    assert parts.test.sum() == pytest.approx((len(enough) - 1) / 3, abs=1)
    assert np.array_equal(photograph_folds(parts, 0) >= 0, parts.validation)


def test_no_photograph_is_judged_by_a_fit_that_saw_it(tmp_path, monkeypatch):
    """Of what is judged: by cross-validation or kept for the report. The calibration pair always trains."""
    recording = once(write_hidden_gel, tmp_path / "recording", [], images=NEEDED)
    twin = Twin.load(linear_twin(tmp_path / "twin", recording))
    trained = {}

    def fit(gel, photographs, effects, makes, near=None, quick=False):
        out = replace(gel)
        trained[id(out)] = out, {id(p) for p in photographs}
        return GelFit(out, 0.0, 1)

    monkeypatch.setattr(gel_study, "fit_photographs", fit)
    for r in (recording, many(recording)):
        study = GelStudy(twin, r)
        model = study.refit([], None, Steps())
        seen = [id(p) in trained[id(g)][1] for g, p in zip(model.gels, study.space.photographs, strict=True)]
        assert seen == [True] + [False] * (len(r) - 1)
        assert min(len(photographs) for _, photographs in trained.values()) >= 0.7 * study.parts.train.sum()
        trained.clear()


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        ("creep", "does not act on a gel"),
        ("gel_creep", "'gel_creep' cannot be tested, record column hold_s"),
        ("shadows", "There is no effect 'shadows'"),
    ],
)
def test_other_effects_are_refused(effect, said, tmp_path):
    recording = once(write_hidden_gel, tmp_path / "recording", [], images=2)
    Twin(device="gel", length_mm=16.0).save(tmp_path / "twin")
    refused(said, "add", twin=tmp_path / "twin", recording=recording.folder, effect=effect)


def test_a_recording_of_one_pair_cannot_be_judged(tmp_path):
    recording = once(write_hidden_gel, tmp_path / "recording", [], images=2)
    recording.keep(np.array([True, False])).write(recording.folder)
    twin = linear_twin(tmp_path / "twin", recording)
    refused("no error can be computed", "diagnose", twin=twin, recording=recording.folder)


def test_a_finger_without_a_gel_is_refused(tmp_path):
    recording = once(write_hidden_gel, tmp_path / "recording", [], images=2)
    Twin.builtin().save(tmp_path / "finger")
    refused("of a gel", "diagnose", twin=tmp_path / "finger", recording=recording.folder)
