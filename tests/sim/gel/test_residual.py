"""The residual field: learnt where five presses show one, not where there is none, and kept with the twin."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.metrics import rmse
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.gel.residual import FEATURES, ResidualField, features
from pneutac_sim.twin import Twin

CELL = 12 / 59, 16 / 80


def wavy(rng) -> ResidualField:
    """One of a few broad bumps."""
    centres = rng.normal(0, 0.7, (3, 6, FEATURES)).astype(np.float32)
    return ResidualField(centres, rng.normal(0, 40, (3, 6)).astype(np.float32))


@pytest.mark.parametrize(
    ("there", "share"), [(True, 0.8), pytest.param(False, 1.05, marks=pytest.mark.nightly)]
)
def test_five_presses_teach_what_the_model_leaves_over_and_no_harm_if_nothing(
    there, share, linear, photograph, session
):
    linear.effects = {"rest_colour": {f"exponent_{c}": 0.7 for c in CHANNELS}}
    truth = replace(linear, residual=wavy(np.random.default_rng(1)) if there else None)
    gel = fit_presses(session(truth, 5), 20.0, ["rest_colour"], makes=()).gel
    assert gel.residual is not None or not there
    press = Press("sphere", 3.0, 0.5, 2.0, 0.8)
    real, bare = photograph(truth, press), replace(gel, residual=None)
    own, without = (rmse(Predictor(g).image(press, linear.rest_image), real) for g in (gel, bare))
    assert own < share * without


def test_a_twin_keeps_it_until_another_gel_comes(linear):
    twin, field = Twin.builtin(), wavy(np.random.default_rng(2))
    replace(linear, residual=field).into_twin(twin)
    kept = GelModel.from_twin(twin).residual
    assert np.array_equal(kept.centres, field.centres) and np.array_equal(kept.weights, field.weights)
    linear.into_twin(twin)
    assert GelModel.from_twin(twin).residual is None


def test_where_nothing_moves_or_far_from_all_that_was_seen_it_adds_nothing():
    field, row = wavy(np.random.default_rng(3)), np.zeros(12)
    u = np.zeros((80, 59), np.float32)
    assert not field.light(0, u, CELL, row).any()
    u[40, 29] = 30.0
    assert abs(field.light(0, u, CELL, row)[40, 29]) < 1e-6
    assert features(u, CELL, row).shape == (80, 59, FEATURES)


def test_a_field_of_other_shapes_is_refused():
    with pytest.raises(InputError, match=r"residual field must be finite numbers of shapes \(3, n, 7\)"):
        ResidualField(np.zeros((3, 4, 6)), np.zeros((3, 4)))
    with pytest.raises(InputError, match="calibrate the gel anew"):
        ResidualField(np.full((3, 4, FEATURES), np.nan), np.zeros((3, 4)))
