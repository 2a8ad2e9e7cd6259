from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_pneutac.diagnosis.search import Found, Scored
from lerobot_pneutac.study.body_model import BodyFitter, BodyStructure, InputModel, rate
from lerobot_pneutac.study.body_search import BodySearch
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.instants import StepProblem, step_rows
from pneutac_sim.least_squares import minimise
from pneutac_sim.twin import Twin
from pneutac_truths import generate, write

COLUMNS = ("tip_x_mm", "tip_y_mm", "tip_z_mm")


def test_the_rate_of_the_drive_stops_at_a_trial_and_leaves_steps_out():
    u = np.array([0.0, 1.0, 3.0, 10.0, 10.0, 16.0, 16.0])[:, None]
    dt = np.array([np.inf, 0.5, 0.5, np.inf, 0.5, 0.5, 0.5])
    np.testing.assert_allclose(rate(u, dt)[:, 0], [2.0, 2.0, 4.0, 0.0, 0.0, 0.0, 0.0])


def test_a_trial_of_which_no_row_was_fitted_has_no_numbers_of_its_own(tmp_path):
    recording = Recording.load(write(generate("rod", ["plain"], 3, minutes=1.0), tmp_path / "r"))
    trial = recording.column("trial")
    fitter = BodyFitter(recording, Twin("finger", recording.length_mm), np.flatnonzero(trial < trial.max()))
    model = fitter.fit(BodyStructure((), InputModel(), 8, trials=(0.01, 0.02, 0.02, 0.01)), {}, 2)
    assert model.of_trials[:-1].any(axis=1).all() and np.abs(model.of_trials[-1]).max() < 1e-9
    assert np.isfinite(fitter.predict(model)).all()


@pytest.mark.parametrize("effects, taken", [(("valve_lag",), True), (("orifice_flow",), False)])
def test_a_better_fit_of_the_same_effects_needs_no_test_and_other_effects_must_be_worth_it(effects, taken):
    def scored(effects: tuple[str, ...], share: float, value: float) -> Scored:
        structure = BodyStructure(effects, InputModel(switch=(share,)))
        return Scored(SimpleNamespace(structure=structure), np.full(4, value), value)

    now, better = scored(("valve_lag",), 0.5, 2.0), scored(effects, 0.4, 1.0)
    search = SimpleNamespace(
        run=map,
        engine=lambda space: SimpleNamespace(
            other_actuations=lambda model: [] if taken else [better], is_worth=lambda before, after: False
        ),
        score=lambda model: better if taken or model is better.model else now,
    )
    space = SimpleNamespace(refine_air=lambda model: model)
    found = Found(now, [now], now)
    assert BodySearch._refined(search, space, now, found) is (better if taken else now)


@pytest.mark.parametrize("needed", [True, False])
def test_a_term_at_its_quickest_stays_where_the_error_rises_without_it(needed):
    """An air faster than the samples ends at the bound of its times, and may still be all that is missing."""
    model = Scored(SimpleNamespace(structure=BodyStructure(("valve_lag",)), values={}), np.ones(4), 1.0)
    bare = Scored(SimpleNamespace(structure=BodyStructure(()), values={}), np.full(4, 9.0), 9.0)
    search = SimpleNamespace(
        study=SimpleNamespace(twin_effects=(), twin=SimpleNamespace(effects=()), recording=None),
        engine=lambda space: SimpleNamespace(is_needed=lambda without, model: needed),
        score=lambda model: bare,
    )
    space = SimpleNamespace(idle=lambda model, term: True, bare=lambda model, term: bare.model)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lerobot_pneutac.study.body_search.base_effects", lambda study: ())
        assert BodySearch.without_idle(search, space, model, ()) is (model if needed else bare)


def test_a_dead_time_may_be_none_and_a_lag_is_no_shorter_than_the_samples_show(tmp_path):
    """Else a model with a dead time errs more than the same model without, and the air's true form loses."""
    recording = Recording.load(write(generate("rod", ["plain"], 3, minutes=1.0), tmp_path / "r"))
    fitter = BodyFitter(recording, Twin("finger", recording.length_mm), np.arange(0, len(recording), 3))
    model = fitter.fit(BodyStructure(("dead_time", "valve_lag"), InputModel()), {}, 0)
    lower = dict(zip(model.pipeline.names, model.bounds.lower, strict=True))
    assert lower["dead_time.delay_s"] == 0.0
    assert lower["valve_lag.fill_time_s"] == pytest.approx(fitter.row_s / 4)


def test_the_air_is_found_with_steps_at_instants_that_nobody_wrote_down(tmp_path):
    recording = Recording.load(write(generate("rod", ["plain"], 3, minutes=1.0), tmp_path / "r"))
    recording = replace(recording, samples=recording.samples.drop(columns="time_sent_s"))
    twin, at = Twin("finger", recording.length_mm), step_rows(recording)
    share = np.full(len(recording), np.nan)
    share[at] = np.random.default_rng(0).integers(2, 22, len(at)) / 24
    structure = BodyStructure(("valve_lag",), InputModel(switch=tuple(share)))
    true = {"valve_lag.fill_time_s": 0.11, "valve_lag.vent_time_s": 0.17}
    model = BodyFitter(recording, twin, np.arange(len(recording))).fit(structure, true, 0)
    predicted = model.pipeline.outputs(
        model.pipeline.run(model.fitter.data(structure.input_model).inputs, model.theta), COLUMNS
    )
    seen = recording.samples.assign(**dict(zip(COLUMNS, predicted.T, strict=True)))
    fitter = BodyFitter(replace(recording, samples=seen), twin, np.arange(len(recording)))
    away = fitter.fit(structure, true | {"valve_lag.fill_time_s": 0.2, "valve_lag.vent_time_s": 0.1}, 0)
    air = [away.pipeline.names.index(name) for name in true]
    steps = StepProblem(fitter.steps(structure.input_model), away.pipeline, away.theta, away.bounds, air)
    best = minimise(steps.residual, steps.jacobian, away.bounds.scaled(away.theta, np.array(air)))
    np.testing.assert_allclose(steps.theta(best.v)[air], list(true.values()), rtol=0.02)
    assert best.steps < 12
