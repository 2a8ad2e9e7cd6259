"""Photographs: where an indenter touches, what the light did since the rest image, and predictions.

Pairs of images that cannot be what they are said to be, and impossible indenters.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import k0, k1

from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import PressPhotograph, check_pair, disc, ncc, psnr, rmse, score
from pneutac_sim.gel.photograph import Predictor, expected_drift, press_depth, registered, session_light
from pneutac_sim.gel.surface import surface

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


CELL = (12 / 59, 16 / 80)


def radius_grid(x0=0.0, y0=0.0):
    x = (np.arange(59) + 0.5) * CELL[0] - 6
    y = (np.arange(80) + 0.5) * CELL[1] - 8
    return np.hypot(*np.meshgrid(x - x0, y - y0))


def ball(r, depth, radius):
    return np.maximum(0, depth - r**2 / (2 * radius)).astype(np.float32)


def closed_form(r, depth, radius, decay):
    """The obstacle problem of a parabola: contact where parabola and K0 meet with one slope."""
    rim = np.sqrt(2 * radius * depth)
    a = brentq(
        lambda a: a / radius / (depth - a * a / (2 * radius)) - k1(a / decay) / (decay * k0(a / decay)),
        1e-6 * rim,
        (1 - 1e-9) * rim,
    )
    outside = (depth - a * a / (2 * radius)) * k0(np.maximum(r, a) / decay) / k0(a / decay)
    return np.where(r < a, depth - r**2 / (2 * radius), outside)


@pytest.mark.parametrize("depth, radius, decay", [(0.9, 3, 1.2), (0.3, 3, 1.2), (0.9, 3, 0.6), (0.5, 6, 1.0)])
def test_a_ball_sags_as_the_closed_form_of_the_layer(depth, radius, decay):
    r = radius_grid(0.3, -0.2)
    u = surface(ball(r, depth, radius), CELL, decay)
    np.testing.assert_allclose(u, closed_form(r, depth, radius, decay), atol=0.03 * depth)


def test_the_obstacle_conditions_hold_for_several_flat_and_round_contacts():
    depth = np.maximum(ball(radius_grid(2, 4), 0.8, 3), ball(radius_grid(-2, -3), 0.4, 5))
    depth[10:20, 40:50] = 0.5
    u = surface(depth, CELL, 1.2).astype(np.float64)
    assert (u >= depth - 1e-6).all()
    kx, ky = (1.2 / CELL[0]) ** 2, (1.2 / CELL[1]) ** 2
    v = np.pad(u, 1, mode="edge")
    pressure = u - kx * (v[1:-1, 2:] + v[1:-1, :-2] - 2 * u) - ky * (v[2:, 1:-1] + v[:-2, 1:-1] - 2 * u)
    off = u > depth + 0.02
    assert off.mean() > 0.5
    # the residual is measured against the diagonal of the operator: an error of u times 1 + 2 (kx + ky)
    assert np.abs(pressure[off]).max() / (1 + 2 * (kx + ky)) < 0.003
    assert pressure.min() / (1 + 2 * (kx + ky)) > -0.003


def test_rmse_and_psnr_of_a_known_error():
    a = np.full((4, 5, 3), 100.0)
    assert rmse(a, a + 2) == 2
    assert psnr(a, a + 2) == pytest.approx(20 * np.log10(255 / 2))
    assert psnr(a, a) == np.inf


def test_ncc_ignores_gain_and_offset_of_each_channel_but_sees_a_swap():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(20, 20, 3))
    assert ncc(a, a * [2, 3, 0.5] + [10, -5, 100]) == pytest.approx(1)
    assert ncc(a, -a) == pytest.approx(-1)
    assert abs(ncc(a, a[..., ::-1])) < 0.5


def test_contact_scores_see_what_whole_frame_scores_hide():
    rng = np.random.default_rng(0)
    rest = np.broadcast_to(np.linspace(0, 200, 240)[None, :, None], (320, 240, 3))
    bump = 40 * disc(rest.shape, 100, 80, 20)[..., None] * rng.choice([-1, 1], (1, 1, 3))
    real = rest + bump
    nothing = score(rest, real, rest, 100, 80, 20)
    assert nothing.ncc > 0.97 and nothing.contact_dncc == 0
    assert nothing.contact_rmse == pytest.approx(20, rel=0.05), "the bump fills a quarter of the disc"
    right = score(rest + 0.9 * bump, real, rest, 100, 80, 20)
    assert right.contact_dncc == pytest.approx(1) and right.contact_rmse == pytest.approx(2, rel=0.05)


def test_a_wrong_balance_of_colours_counts_in_the_difference():
    rng = np.random.default_rng(0)
    rest, d = np.full((60, 60, 3), 100.0), rng.normal(size=(60, 60, 1)) * [10, 10, 10]
    tinted = score(rest + d * [1, -1, 1], rest + d, rest, 30, 30, 10)
    assert tinted.contact_dncc == pytest.approx(1 / 3, abs=0.05)


BALL = Press("sphere", 3.0, 0.6, -1.0, 0.9)
NOTHING = Press("sphere", 3.0, 0, 0, 1e-6)


@pytest.mark.parametrize(
    "press", [BALL, Press("cube", 4.0, -1, 2, 0.5, 0.3), Press("edge", 6.0, 0, 0, 0.6, 1.0)]
)
def test_a_pair_is_refused_when_swapped_and_taken_when_not(press, photograph):
    gel = GelModel.builtin()
    rest, image = photograph(gel, NOTHING, noise=3, seed=1), photograph(gel, press, noise=3)
    check_pair(rest, image, press, 20.0)
    with pytest.raises(InputError, match="swapped"):
        check_pair(image, rest, press, 20.0)


def test_bad_pairs_get_one_sentence(photograph):
    gel = GelModel.builtin()
    rest, image = gel.rest_image, photograph(gel, BALL, noise=2)
    for says, pair in {
        "the same picture": (rest, rest.copy(), BALL),
        "shows no contact": (rest, image, Press("sphere", 3.0, -3, 5, 0.9)),
        "lies outside the image": (rest, image, Press("sphere", 3.0, 0, 30, 0.9)),
        "another sensor": (np.ascontiguousarray(rest[::-1, ::-1]), image, BALL),
        "one size": (rest[:200], image, BALL),
        "pixels wide": (rest, image, Press("sphere", 3.0, 0, 0, 1e-8)),
        "the contact is saturated": (rest, np.where(image == rest, image, 255).astype(np.uint8), BALL),
        "the rest image is saturated": (np.full_like(rest, 255), image, BALL),
    }.items():
        with pytest.raises(InputError, match=says) as e:
            fit_presses([PressPhotograph(pair[2], pair[1], pair[0])], 20.0)
        assert "\n" not in str(e.value)
    with pytest.raises(InputError, match="shows no contact"):
        check_pair(rest, photograph(gel, NOTHING, noise=2), BALL, 20.0)


@pytest.mark.parametrize("bad", [{"indenter": "thumb"}, {"depth_mm": 0.0}, {"size_mm": float("nan")}])
def test_impossible_indenters_are_refused(bad):
    with pytest.raises(InputError):
        Press(**{"indenter": "sphere", "size_mm": 3.0, "x_mm": 0, "y_mm": 0, "depth_mm": 0.5} | bad)


@pytest.mark.parametrize(
    ("flip", "said"),
    [((slice(None), slice(None, None, -1)), "left to right"), (slice(None, None, -1), "top to bottom")],
)
def test_mirrored_images_are_told_from_a_missing_contact(flip, said):
    gel, press = GelModel.builtin(), Press("sphere", 3.0, 2.5, -3.0, 0.9)
    image = Predictor(gel).image(press, gel.rest_image)
    check_pair(gel.rest_image, image, press, 20.0)
    with pytest.raises(InputError, match=f"but one at .* mirrored {said}"):
        check_pair(gel.rest_image[flip], image[flip], press, 20.0)
