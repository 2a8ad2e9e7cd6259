"""The residual field: learnt where five presses show one, not where there is none, and kept with the twin."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.effects.shadow import cast
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.metrics import rmse
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import gradient, light
from pneutac_sim.gel.photograph import Predictor, to_grid
from pneutac_sim.gel.residual import (
    FEATURES,
    LEAST_MM,
    MOVED_MM,
    PLACE,
    SLOPE,
    Leftover,
    ResidualField,
    features,
    levels,
    trusted_share,
)
from pneutac_sim.twin import Twin

CELL = 12 / 59, 16 / 80


def wavy(rng) -> ResidualField:
    """One of a few broad bumps, which reaches over the whole gel."""
    centres = np.repeat(rng.normal(0, 0.7, (3, 6, FEATURES)), 30, 1).astype(np.float32)
    centres[..., PLACE] = rng.uniform(-1, 1, (3, 180, 2))
    return ResidualField(centres, np.repeat(rng.normal(0, 3, (3, 6)), 30, 1).astype(np.float32))


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


def test_it_adds_what_its_formula_says(linear):
    field, u = wavy(np.random.default_rng(6)), np.zeros((80, 59), np.float32)
    u[20:60, 10:40] = np.random.default_rng(7).uniform(0, 1.2, (40, 30))
    rows = linear.coefficients
    added = levels([field], u, CELL, [cast(u, *CELL, row) for row in rows])
    share = np.minimum(u / MOVED_MM, 1) * (u > LEAST_MM)
    for k, row in enumerate(rows):
        z = features(u, CELL, row)
        np.testing.assert_allclose(z[..., :2] * SLOPE, np.stack(gradient(u, CELL), -1), atol=1e-5)
        expected = field.at(k, z.reshape(-1, FEATURES)).reshape(u.shape)
        np.testing.assert_allclose(added[k], share * expected, atol=2e-3)


def test_it_adds_the_same_levels_where_the_rest_image_is_bright_and_where_it_is_dark(linear):
    field = wavy(np.random.default_rng(4))
    linear.rest_image[:, :120], linear.rest_image[:, 120:] = 60, 120
    u = np.full((80, 59), 0.3, np.float32)
    added = []
    for exponent in (0.0, 1.5):
        effects = {"rest_colour": {f"exponent_{c}": exponent for c in CHANNELS}}
        gel = replace(linear, effects=effects, residual=field)
        with_it, without = (
            light(u, CELL, *g.lighting).transpose(1, 2, 0) for g in (gel, replace(gel, residual=None))
        )
        w = gel.weight_on(to_grid(linear.rest_image))
        added.append(w * (with_it - without))
    assert np.ptp(w) > 0.5 and np.abs(added[0]).max() > 1
    np.testing.assert_allclose(added[1], added[0], atol=1e-3)


@pytest.mark.parametrize(
    ("agreement", "low", "high"), [(1.0, 0.8, 1.0), (0.5, 0.3, 0.5), (0.0, 0, 0.2), (-1.0, 0, 0)]
)
def test_as_much_of_it_is_taken_as_presses_bear_out_that_it_was_not_learnt_from(agreement, low, high):
    rng, tried = np.random.default_rng(5), []
    for _ in range(5):
        field, z = wavy(rng), rng.normal(0, 0.7, (3, 300, FEATURES))
        one = Leftover(z, np.ones((3, 300)), np.zeros((3, 300)), np.ones(300, bool))
        own = wavy(rng)  # what this press has for itself
        one.levels = agreement * one.added(field) + 0.2 * one.added(own)
        tried.append((field, one))
    assert low <= trusted_share(tried) <= high


def test_a_field_of_other_shapes_is_refused():
    with pytest.raises(InputError, match=r"residual field must be finite numbers of shapes \(3, n, 7\)"):
        ResidualField(np.zeros((3, 4, 6)), np.zeros((3, 4)))
    with pytest.raises(InputError, match="calibrate the gel again"):
        ResidualField(np.full((3, 4, FEATURES), np.nan), np.zeros((3, 4)))
