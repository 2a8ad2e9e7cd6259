"""Photographs: where an indenter touches, what the light did since the rest image, and predictions."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import (
    Predictor,
    PressPhotograph,
    expected_drift,
    press_depth,
    registered,
    session_light,
)

BALL = Press("sphere", 3.0, 0.6, -1.0, 0.9)
OTHER = Press("sphere", 3.0, -2.0, 4.0, 0.7)


def lit(image, levels):
    return np.clip(image + np.array(levels, float), 0, 255).round().astype(np.uint8)


@pytest.fixture
def drifted(linear, photograph):
    """A photograph of a contact since whose rest image the light has changed by known levels."""
    image = photograph(linear, BALL)
    return PressPhotograph(BALL, lit(image, [10, -6, 4]), linear.rest_image)


# ---------------------------------------------------------------- where it touches


@pytest.mark.parametrize("kind", INDENTERS)
def test_every_indenter_touches_at_its_place_and_depth(kind):
    gel = GelModel.builtin()
    depth = press_depth(Press(kind, 3.0, 1.0, -2.0, 0.7, yaw_rad=0.4), gel)
    assert 0.5 < depth.max() <= 0.7 + 1e-5
    i, j = np.nonzero(depth > 0.9 * depth.max())
    assert np.mean((j + 0.5) * 12 / 59 - 6) == pytest.approx(1.0, abs=0.15)
    assert np.mean((i + 0.5) * 0.2 - 8) == pytest.approx(-2.0, abs=0.15)


def test_a_registration_shift_turns_scales_and_moves_a_press(linear):
    assert registered(OTHER, linear) is OTHER
    v = {"shift_x_mm": 0.5, "shift_y_mm": -1.0, "turn_rad": 0.3, "scale": 1.25}
    true = registered(replace(OTHER, yaw_rad=0.1), replace(linear, effects={"registration_shift": v}))
    expected = 1.25 * np.exp(0.3j) * complex(OTHER.x_mm, OTHER.y_mm) + complex(0.5, -1.0)
    assert complex(true.x_mm, true.y_mm) == pytest.approx(expected)
    assert true.yaw_rad == pytest.approx(0.4)
    assert (true.depth_mm, true.size_mm) == (OTHER.depth_mm, OTHER.size_mm)


# ---------------------------------------------------------------- light of the session


def test_the_sessions_light_is_read_away_from_the_contact_and_filled_in_under_it(drifted):
    drift = session_light(drifted, 20.0)
    assert drift.shape == (80, 59, 3)
    np.testing.assert_allclose(drift.mean((0, 1)), [10, -6, 4], atol=0.3)
    np.testing.assert_allclose(drift, np.broadcast_to([10, -6, 4], drift.shape), atol=1.5)


@pytest.mark.parametrize(("n", "noise"), [(1, 3.0), (5, 3.0), (1, 1.0), (1, 0.3)])
def test_photographs_take_out_of_predictions_what_noise_the_rest_image_has(linear, n, noise):
    rng, true = np.random.default_rng(0), linear.rest_image.astype(float).clip(20, 230)
    rest = np.uint8(np.round(true + rng.normal(0, noise, true.shape)))
    images = [np.uint8(np.round(true + rng.normal(0, 3, true.shape))) for _ in range(n)]
    pairs = [PressPhotograph(OTHER, image, rest) for image in images]
    expected, near = expected_drift(pairs, rest, linear.px_per_mm), pairs[0].near(linear.px_per_mm)
    left, own = rest + expected - true, rest - true
    assert left[near].std() == pytest.approx(own[near].std(), rel=0.05)
    best = (own[~near].var() ** -1 + n / 9) ** -0.5  # of a mean by inverse variances
    assert left[~near].std() == pytest.approx(best, rel=0.05)


def test_a_gel_that_knows_the_drift_needs_no_pair(linear, drifted):
    v = {f"{kind}_{c}": float(kind == "gain") for kind in ("gain", "drift") for c in ("red", "green", "blue")}
    linear.effects = {"illumination_drift": v | {"gain_red": 1.1, "drift_red": -0.2}}
    predictor = Predictor(linear, [drifted])
    for clock, gain in ((0.0, 1.1), (0.5, 1.0), (1.0, 0.9)):
        image = predictor.image(OTHER, drifted.rest, clock).astype(float)
        bright = drifted.rest[..., 0] < 200
        far = ~PressPhotograph(OTHER, drifted.image, drifted.rest).near(20.0) & bright
        assert np.median(image[far, 0] / drifted.rest[far, 0]) == pytest.approx(gain, abs=0.01)
        np.testing.assert_allclose(image[far, 1], drifted.rest[far, 1], atol=2)


def test_each_photograph_is_predicted_on_its_own_rest_image(linear):
    predictor = Predictor(linear)
    first, second = linear.rest_image, np.full_like(linear.rest_image, 90)
    far = ~PressPhotograph(OTHER, first, first).near(20.0)
    for rest in (first, second, first):
        np.testing.assert_allclose(predictor.image(OTHER, rest)[far], rest[far].astype(float), atol=3)
