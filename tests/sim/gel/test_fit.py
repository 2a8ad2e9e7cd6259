"""Calibration to one pair of images: what it finds, and how well it predicts elsewhere.

What presses identify of a gel's light, and which one to add.

Calibration to several photographs: what one cannot tell, and what the session adds.
"""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_photographs, fit_presses, standard_effects
from pneutac_sim.gel.identifiability import DEEPEST, identify
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, Orientation
from pneutac_sim.gel.pair import PressPhotograph, rmse
from pneutac_sim.gel.photograph import Predictor

BALL = Press("sphere", 3.0, 0.6, -1.0, 0.9)
ELSEWHERE = [Press("sphere", 3.0, -2.5, 3.5, 0.6), Press("sphere", 3.0, 2.5, -4.0, 1.1)]


def angles_deg(a, b):
    """Between the light of each channel of two gels."""
    a, b = (np.arctan2(g.light[:, 1], g.light[:, 0]) for g in (a, b))
    return np.degrees(np.abs((a - b + np.pi) % (2 * np.pi) - np.pi))


@pytest.mark.parametrize("depth_scale", [1.0, 0.7])
def test_the_linear_model_is_recovered(depth_scale, linear, photograph):
    linear.depth_scale = depth_scale
    fit = fit_presses([PressPhotograph(BALL, photograph(linear, BALL, noise=2), linear.rest_image)], 20.0, ())
    assert fit.gel.effects == {} and fit.make == "" and fit.evaluations > 10
    assert fit.gel.decay_mm == pytest.approx(1.1, rel=0.05)
    assert fit.gel.depth_scale == pytest.approx(depth_scale, abs=0.03)
    np.testing.assert_allclose(fit.gel.light, linear.light, atol=4)
    np.testing.assert_allclose(fit.gel.depth_light, linear.depth_light, atol=2 / depth_scale)


def test_a_drift_of_the_light_does_not_mislead_the_fit(linear, photograph):
    image = photograph(linear, BALL, noise=2, gain=1.05)
    gel = fit_presses([PressPhotograph(BALL, image, linear.rest_image)], 20.0, ()).gel
    assert angles_deg(gel, linear).max() < 1.5
    strength, truth = (np.linalg.norm(g.light, axis=1) for g in (gel, linear))
    np.testing.assert_allclose(strength / truth, 1, atol=0.06)
    assert gel.decay_mm == pytest.approx(1.1, rel=0.1)


def test_one_pair_predicts_other_places_and_depths_of_a_sensor_with_every_effect(bent, photograph):
    """Less than a fifth of the rest image's error is left, half of what the linear model leaves."""
    image = photograph(bent, BALL, noise=2)
    fit = fit_presses([PressPhotograph(BALL, image, bent.rest_image)], 20.0)
    linear = fit_presses([PressPhotograph(BALL, image, bent.rest_image)], 20.0, ()).gel
    assert set(fit.gel.effects) == set(standard_effects())
    for press in ELSEWHERE:
        real = photograph(bent, press)
        ours, plain = (rmse(Predictor(g).image(press, bent.rest_image), real) for g in (fit.gel, linear))
        assert ours < 0.2 * rmse(bent.rest_image, real) and ours < 0.55 * plain
    for name, values in fit.gel.effects.items():
        for p in get_effect(name).parameters:
            assert p.lower <= values[p.name] <= p.upper


@pytest.mark.slow
def test_of_an_unknown_sensor_one_press_tells_no_shadow_and_two_do(bent, session):
    bent.rest_image = np.ascontiguousarray(
        bent.rest_image.mean(2, keepdims=True).repeat(3, 2).astype(np.uint8)
    )
    presses = session(bent, 2)
    one, two = (fit_presses(p, bent.px_per_mm, makes=()) for p in (presses[:1], presses))
    assert set(standard_effects()) - set(one.gel.effects) == {"shadow"}
    assert set(two.gel.effects) == set(standard_effects())


def test_each_press_is_checked(linear, session):
    presses = session(linear, 2)
    presses[1] = replace(presses[1], image=presses[1].rest.copy())
    with pytest.raises(InputError, match="same picture"):
        fit_presses(presses, linear.px_per_mm)


def test_images_that_are_mirrored_and_bgr_are_recognised_and_lit_by_the_makes_lights(linear, photograph):
    """A DIGIT's images flipped left to right, with reversed channels, still tell the make's lights."""
    positions = np.array(DIGIT.positions_mm)
    distance = np.linalg.norm(positions, axis=1)
    linear.light = -100 * positions / distance[:, None]
    names = [p.name for p in get_effect("near_light").parameters]
    linear.effects["near_light"] = dict(zip(names, distance.tolist(), strict=True))
    rest, image = linear.rest_image, photograph(linear, BALL, noise=2)
    rest, image = (np.ascontiguousarray(a[:, ::-1, ::-1]) for a in (rest, image))
    mirrored = replace(BALL, x_mm=-BALL.x_mm)
    fit = fit_presses([PressPhotograph(mirrored, image, rest)], 20.0, ("near_light", "rest_colour"))
    assert fit.make == "DIGIT" and fit.orientation == Orientation((2, 1, 0), mirror_x=True)
    found = [fit.gel.effects["near_light"][n] for n in names]
    np.testing.assert_allclose(found, distance[::-1], rtol=0.15)
    plain = fit_presses([PressPhotograph(mirrored, image, rest)], 20.0, ("near_light",))
    assert plain.make == "", "without the rest colour there is nothing that a make could lend"


@pytest.mark.parametrize(
    "effect, tolerance",
    [
        ("photometric_nonlinearity", {"direct_{}_levels": 0.15}),
        ("shadow", {"shadow_{}_levels": 0.2, "elevation_{}": 0.1}),
    ],
)
def test_one_pair_tells_an_effect_that_shows_at_one_place(effect, tolerance, bent, photograph):
    bent.effects = {effect: bent.effects[effect]}
    pair = PressPhotograph(BALL, photograph(bent, BALL, noise=2), bent.rest_image)
    fit = fit_photographs(bent, [pair], [effect], makes=())
    assert set(fit.gel.effects) == {effect}
    for name, rel in tolerance.items():
        for k, channel in enumerate(("red", "green", "blue")):
            found, truth = (gel.effects[effect][name.format(channel)] for gel in (fit.gel, bent))
            # one press may leave Lambert's phi open against the squares of the slopes, and then says so
            open_ = fit.channels[k].deviations()[effect, name.replace("_{}", "")]
            assert found == pytest.approx(truth, abs=max(rel * truth, open_))
    deeper = replace(BALL, depth_mm=1.2)
    assert rmse(Predictor(fit.gel).image(deeper, bent.rest_image), photograph(bent, deeper)) < 0.5


SHALLOW = Press("sphere", 3.0, 3.0, -4.0, 0.5)


@pytest.fixture(scope="module")
def fitted(photograph):
    """Photographs of a gel and the fit to them."""

    def fit(gel, *presses):
        pairs = [PressPhotograph(p, photograph(gel, p, 2, i), gel.rest_image) for i, p in enumerate(presses)]
        found = fit_presses(pairs, 20.0, ["near_light", "rest_colour"], makes=())
        return identify(found.gel, found.channels, pairs)

    return fit


def test_the_press_to_add_lies_where_none_was_and_deeper_and_makes_it_better_known(linear, fitted):
    one = fitted(linear, SHALLOW)
    assert one.deeper and SHALLOW.depth_mm < one.add.depth_mm <= DEEPEST * 2.5
    assert np.hypot(one.add.x_mm - SHALLOW.x_mm, one.add.y_mm - SHALLOW.y_mm) > 3.0
    assert one.where != "upper right" and one.add.indenter == "sphere"
    two = fitted(linear, SHALLOW, one.add)
    assert (
        one.then_levels == pytest.approx(two.open_levels, rel=0.3) and two.open_levels < 0.7 * one.open_levels
    )
    assert set(two.unidentified) < set(one.unidentified), "two places tell how far the lights are"
    assert any(name.startswith("near_light.distance_mm") for name in one.unidentified)


def test_an_error_of_the_fit_is_no_larger_than_it_is_said_to_be(linear, photograph):
    """Errors of the strength of the light over draws of the noise, against their covariance."""
    linear.light *= 0.5
    press, light, spread = replace(SHALLOW, depth_mm=0.8), [], []
    for seed in range(6):
        pair = PressPhotograph(press, photograph(linear, press, 2, seed), linear.rest_image)
        fit = fit_presses([pair], 20.0, [], makes=())
        light.append(np.linalg.norm(fit.gel.light, axis=1) - np.linalg.norm(linear.light, axis=1))
        spread.append([np.sqrt(c.covariance[0, 0]) for c in fit.channels])
    assert np.sqrt(np.mean(np.square(light))) < 1.5 * np.mean(spread)


DRIFT = {"gain_red": 1.04, "gain_green": 0.97, "gain_blue": 1.02}
DRIFT |= {"drift_red": -0.08, "drift_green": 0.05, "drift_blue": 0.1}
SHIFT = {"shift_x_mm": 0.5, "shift_y_mm": -0.4, "turn_rad": 0.06, "scale": 1.05}
THERE = Press("sphere", 3.0, 0.5, 5.5, 0.9)


def off(found, truth):
    return np.abs([found[k] - truth[k] for k in truth])


def test_several_places_pin_how_far_the_lights_are_and_how_they_spread(bent, session):
    effects = ("near_light", "rest_colour")
    bent.effects = {e: bent.effects[e] for e in effects}
    one, many = (fit_photographs(bent, session(bent, n), effects, makes=()).gel.effects for n in (1, 4))

    def apart(found, effect, name):
        return np.array(
            [found[effect][name.format(c)] / bent.effects[effect][name.format(c)] for c in CHANNELS]
        )

    distances = [np.abs(np.log(apart(f, "near_light", "distance_{}_mm"))) for f in (one, many)]
    assert (distances[1] < 0.6 * distances[0]).all()
    assert distances[1][:2].max() < 0.1, "lights no farther than two windows are found"
    exponents = [off(f["rest_colour"], bent.effects["rest_colour"]).mean() for f in (one, many)]
    assert exponents[1] < 0.7 * exponents[0]


def test_an_uncertain_press_is_found_in_its_image_and_the_others_hold(linear, session, photograph):
    true = Press("cube", 4.0, -1.0, 0.5, 0.6, 0.4, tilt_x_rad=-0.03, tilt_y_rad=0.02)
    wrong = {"x_mm": 0.3, "y_mm": -0.2, "depth_mm": 0.08, "yaw_rad": 0.08}
    wrong |= {"tilt_x_rad": 0.03, "tilt_y_rad": -0.02}
    stated = replace(true, **{k: getattr(true, k) + v for k, v in wrong.items()})
    sd = {"x_mm": 0.2, "y_mm": 0.2, "depth_mm": 0.1, "yaw_rad": 0.1, "tilt_x_rad": 0.04, "tilt_y_rad": 0.04}
    cube = PressPhotograph(stated, photograph(linear, true, 2), linear.rest_image, 0.0, sd)
    balls = session(linear, 3)
    found = fit_photographs(linear, [*balls, cube], []).presses
    assert found[:3] == [p.press for p in balls]
    left = {k: abs(getattr(found[3], k) - getattr(true, k)) / abs(v) for k, v in wrong.items()}
    assert max(left.values()) < 0.4, left


@pytest.mark.parametrize("drift", [False, True])
def test_contacts_beside_their_stated_place_are_found(drift, linear, session, photograph):
    effects = ["registration_shift", *(["illumination_drift"] if drift else [])]
    linear.effects["registration_shift"] = SHIFT
    if drift:
        linear.effects["illumination_drift"] = DRIFT
    photographs = session(linear, 4)
    gel = fit_photographs(linear, photographs, effects).gel
    assert set(gel.effects) == set(effects)
    assert (off(gel.effects["registration_shift"], SHIFT) < [0.04, 0.04, 0.01, 0.01]).all()
    if drift:
        assert off(gel.effects["illumination_drift"], DRIFT).max() < 0.012
        late = photograph(linear, THERE, clock=0.9)
        assert rmse(Predictor(gel).image(THERE, linear.rest_image, 0.9), late) < 1.5
        assert rmse(Predictor(gel).image(THERE, linear.rest_image, 0.0), late) > 3.0
    np.testing.assert_allclose(gel.light, linear.light, atol=5)
    real = photograph(linear, THERE, clock=0.5)
    ours = rmse(Predictor(gel).image(THERE, linear.rest_image, 0.5), real)
    without = [e for e in effects if e != "registration_shift"]
    plain = fit_photographs(linear, photographs, without).gel
    assert ours < 0.3 * rmse(Predictor(plain).image(THERE, linear.rest_image, 0.5), real)


@pytest.mark.parametrize(("effect", "most"), [("illumination_drift", 0.003), ("registration_shift", 0.02)])
def test_a_steady_light_and_contacts_at_their_stated_place_stay_so(effect, most, linear, session):
    found = fit_photographs(linear, session(linear, 3), [effect]).gel.effects
    neutral = {p.name: p.neutral for p in get_effect(effect).parameters}
    assert off(found[effect], neutral).max() < most
