"""Calibration to several photographs: what one cannot tell, and what the session adds."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.gel.fit import fit_photographs
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.pair import PressPhotograph, rmse
from pneutac_sim.gel.photograph import Predictor

DRIFT = {"gain_red": 1.04, "gain_green": 0.97, "gain_blue": 1.02}
DRIFT |= {"drift_red": -0.08, "drift_green": 0.05, "drift_blue": 0.1}
SHIFT = {"shift_x_mm": 0.5, "shift_y_mm": -0.4, "turn_rad": 0.06, "scale": 1.05}
ELSEWHERE = Press("sphere", 3.0, 0.5, 5.5, 0.9)


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


def test_a_drift_of_the_light_is_recovered_and_taken_out_of_the_gel(linear, session, photograph):
    linear.effects["illumination_drift"] = DRIFT
    photographs = session(linear, 4)
    gel = fit_photographs(linear, photographs, ["illumination_drift"]).gel
    assert set(gel.effects) == {"illumination_drift"}
    assert off(gel.effects["illumination_drift"], DRIFT).max() < 0.012
    np.testing.assert_allclose(gel.light, linear.light, atol=4)
    late = photograph(linear, ELSEWHERE, clock=0.8)
    assert rmse(Predictor(gel).image(ELSEWHERE, linear.rest_image, clock=0.8), late) < 1.0
    assert rmse(Predictor(gel).image(ELSEWHERE, linear.rest_image, clock=0.0), late) > 3.0


@pytest.mark.parametrize("drift", [False, True])
def test_contacts_beside_their_stated_place_are_found(drift, linear, session, photograph):
    effects = ["registration_shift", *(["illumination_drift"] if drift else [])]
    linear.effects["registration_shift"] = SHIFT
    if drift:
        linear.effects["illumination_drift"] = DRIFT
    photographs = session(linear, 4)
    gel = fit_photographs(linear, photographs, effects).gel
    assert (off(gel.effects["registration_shift"], SHIFT) < [0.04, 0.04, 0.01, 0.01]).all()
    if drift:
        assert off(gel.effects["illumination_drift"], DRIFT).max() < 0.012
    np.testing.assert_allclose(gel.light, linear.light, atol=5)
    real = photograph(linear, ELSEWHERE, clock=0.5)
    ours = rmse(Predictor(gel).image(ELSEWHERE, linear.rest_image, 0.5), real)
    without = [e for e in effects if e != "registration_shift"]
    plain = fit_photographs(linear, photographs, without).gel
    assert ours < 0.3 * rmse(Predictor(plain).image(ELSEWHERE, linear.rest_image, 0.5), real)


@pytest.mark.parametrize(("effect", "most"), [("illumination_drift", 0.003), ("registration_shift", 0.02)])
def test_a_steady_light_and_contacts_at_their_stated_place_stay_so(effect, most, linear, session):
    found = fit_photographs(linear, session(linear, 3), [effect]).gel.effects
    neutral = {p.name: p.neutral for p in get_effect(effect).parameters}
    assert off(found[effect], neutral).max() < most
