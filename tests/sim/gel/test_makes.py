"""Priors of makes as files."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from sensors import wavy

from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_presses, priors
from pneutac_sim.gel.identifiability import library, save
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, Layout, Orientation, SensorPrior, recognise_rest, stored_rest
from pneutac_sim.gel.model import GelModel, rest_image
from pneutac_sim.gel.pair import PressPhotograph, rmse
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.twin import Twin


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    monkeypatch.setenv("PNEUTAC_PRIORS", str(tmp_path / "priors"))
    return tmp_path / "priors"


def test_a_layout_comes_back_from_its_file(tmp_path):
    sds = (1.0, 2.0, 30.0), (0.05, 0.1, 0.2), (0.05, 0.06, 0.5)
    rest = stored_rest(rest_image((80, 80, 3)))
    made = Layout(
        "lab",
        ((1.0, 2.0), (3.0, -4.0), (-5.0, 6.5)),
        (0.5, 1.5, -0.2),
        1.0,
        rest,
        *sds,
    )
    made.write(tmp_path / "lab.yaml", "a test")
    back = Layout.read(tmp_path / "lab.yaml")
    assert back == made
    np.testing.assert_allclose(back.rest, made.rest, atol=0.5)


def test_the_library_holds_the_products_makes_and_ones_own(own, linear, photograph):
    assert library() == (DIGIT,), "without any of one's own"
    press = Press("sphere", 3.0, 0.6, -1.0, 0.9)
    pair = PressPhotograph(press, photograph(linear, press, 2), linear.rest_image)
    fit = fit_presses([pair], 20.0, ["near_light", "rest_colour"], makes=())
    file = save("lab", fit.gel, fit.channels, "a test")
    assert file == own / "lab.yaml"
    lab = library()[1]
    assert lab.name == "lab" and recognise_rest(linear.rest_image, lab)[1] > 0.99
    light = np.array(lab.positions_mm) / np.linalg.norm(lab.positions_mm, axis=1)[:, None]
    np.testing.assert_allclose(light, -linear.light / np.linalg.norm(linear.light, axis=1)[:, None], atol=0.1)
    assert min(lab.distances_sd_mm) > 20, "one press does not tell how far the lights are"
    prior = priors(0, linear.light[0], lab, fit.channels[0]._effects)["near_light", "distance_mm"]
    assert prior[1] == lab.distances_sd_mm[0]


def unit() -> SensorPrior:
    """A sensor of a make that left something over."""
    return SensorPrior(np.zeros((16, 12, 3)), wavy(np.random.default_rng(4)).times(1 / 3000))


def test_a_make_lends_what_it_left_over_on_other_sensors_and_never_on_the_very_one(tmp_path):
    assert len(DIGIT.units) > 1
    for own in DIGIT.units:
        image = cv2.resize(own.rest.clip(0, 255).astype(np.uint8), (240, 320))
        for way in (Orientation(), Orientation((2, 1, 0), True, False)):
            prior = DIGIT.prior_field(np.ascontiguousarray(way.shown(image)), way)
            others = [
                u.field.shown(way.channels, way.mirror_x, way.mirror_y) for u in DIGIT.units if u is not own
            ]
            assert np.array_equal(prior.centres, np.concatenate([f.centres for f in others], 1))
    one = DIGIT.units[0]
    alone = replace(DIGIT, units=(one,))
    alone.write(tmp_path / "alone.yaml", "a test")
    back = Layout.read(tmp_path / "alone.yaml").units[0]
    np.testing.assert_allclose(back.field.weights, one.field.weights, rtol=1e-3, atol=1e-4)
    assert alone.prior_field(cv2.resize(one.rest.astype(np.uint8), (240, 320)), Orientation()) is None


@pytest.mark.parametrize("true", [True, False])
def test_as_much_of_a_prior_field_is_taken_as_explains_the_press(linear, photograph, true):
    linear.effects = {"rest_colour": {f"exponent_{c}": 0.5 for c in CHANNELS}}
    other = unit()
    strength = np.linalg.norm(linear.light)
    truth = replace(linear, prior_residual=other.field.times(strength if true else -strength))
    press = Press("sphere", 3.0, 0.6, -1.0, 0.9)
    pair = PressPhotograph(press, photograph(truth, press), linear.rest_image)
    towards = -linear.light / np.linalg.norm(linear.light, axis=1)[:, None]
    lights = tuple(map(tuple, 40 * towards))
    make = Layout("lab", lights, (0.5, 0.5, 0.5), 1.0, stored_rest(linear.rest_image), units=(other,))
    make = replace(make, proportions=linear.rest_image.shape[1] / linear.rest_image.shape[0])
    bare, fit = (
        fit_presses([pair], 20.0, ["near_light", "rest_colour"], makes=(m,))
        for m in (replace(make, units=()), make)
    )
    assert fit.make == "lab" and bare.prior_share == 0
    assert (fit.prior_share > 0) == true and (fit.gel.prior_residual is not None) == true
    if true:
        there = Press("sphere", 3.0, -2.0, 1.5, 0.8)
        real = photograph(truth, there)
        own, without = (rmse(Predictor(f.gel).image(there, linear.rest_image), real) for f in (fit, bare))
        assert own < 0.9 * without


def test_a_twin_keeps_its_fields_until_another_gel_comes_also_one_of_an_earlier_version(linear):
    twin, field = Twin("gel"), wavy(np.random.default_rng(2))
    replace(linear, prior_residual=field, residual=field).into_twin(twin)
    for part in ("centres", "weights"):
        twin.arrays[f"lent_{part}"] = twin.arrays.pop(f"prior_residual_{part}")
    again = GelModel.from_twin(twin)
    for stored in (again.prior_residual, again.residual):
        assert np.array_equal(stored.weights, field.weights) and np.array_equal(stored.centres, field.centres)
    again.into_twin(twin)
    assert "prior_residual_weights" in twin.arrays and "lent_weights" not in twin.arrays
    linear.into_twin(twin)
    assert GelModel.from_twin(twin).residual is None


def test_five_presses_save_a_field_that_others_of_the_make_are_lent(own, linear, session):
    fit = fit_presses(session(linear, 5), 20.0, ["near_light", "rest_colour"], makes=())
    save("lab", fit.gel, fit.channels, "a test", fit.leftovers)
    lab = library()[1]
    assert len(lab.units) == 1
    assert lab.prior_field(linear.rest_image, Orientation()) is None, "the sensor itself"
    assert lab.prior_field(linear.rest_image[::-1].copy(), Orientation()) is not None


def test_what_is_no_prior_gets_one_sentence(own, linear, photograph):
    own.mkdir()
    (own / "bad.yaml").write_text("format: pneutac-prior-1\nred: {x_mm: far}\n")
    with pytest.raises(InputError, match="bad.yaml: field 'name' is missing"):
        library()
    DIGIT.write(own / "bad.yaml", "a test")
    (own / "bad.yaml").write_text((own / "bad.yaml").read_text().replace("field: ", "field: A"))
    with pytest.raises(InputError, match="bad.yaml is no prior of a sensor"):
        library()
    with pytest.raises(InputError, match="near_light and rest_colour"):
        save("lab", linear, [], "a test")
