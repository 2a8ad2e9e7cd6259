import numpy as np

from lerobot_pneutac.study.body_model import BodyFitter, BodyStructure, InputModel, rate
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin
from pneutac_truths import generate, write


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
