import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_gel, press_depth
from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor

BALL = Press("sphere", 3.0, 0.6, -1.0, 0.9)


def photograph(gel, press, noise=0.0, seed=0):
    image = TactileSensor(gel).image(press_depth(press, gel)).astype(float)
    image += noise * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(image, 0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("multiply", [True, False])
def test_fit_recovers_the_model_that_made_the_images(multiply):
    truth = GelModel.builtin()
    truth.multiply, truth.decay_mm = multiply, 1.1
    gel, _ = fit_gel(truth.rest_image, photograph(truth, BALL, noise=2), BALL, 20.0, multiply)
    assert gel.decay_mm == pytest.approx(1.1, rel=0.05)
    np.testing.assert_allclose(gel.light, truth.light, atol=4)
    np.testing.assert_allclose(gel.depth_light, truth.depth_light, atol=2)


def test_fit_finds_mirrored_axes_and_swapped_channels():
    truth = GelModel.builtin()
    truth.light = truth.light[::-1] * [-1, 1]
    gel, _ = fit_gel(truth.rest_image, photograph(truth, BALL), BALL, 20.0)
    np.testing.assert_allclose(gel.light, truth.light, atol=3)


def test_threshold_is_the_noise_of_the_quiet_part():
    truth = GelModel.builtin()
    quiet, _ = fit_gel(truth.rest_image, photograph(truth, BALL, noise=1), BALL, 20.0)
    noisy, _ = fit_gel(truth.rest_image, photograph(truth, BALL, noise=8), BALL, 20.0)
    assert quiet.threshold_levels == 4.0 and 10 < noisy.threshold_levels < 25
    noise = photograph(truth, Press("sphere", 3.0, 0, 0, 1e-6), noise=8, seed=5)
    assert TactileSensor(noisy).contact(noise).area < 0.003


def test_resizing_keeps_the_physics():
    gel = GelModel.builtin().resized(640, 480)
    assert gel.window_mm == pytest.approx((12, 16)) and gel.px_per_mm == 40
    large = photograph(gel, BALL).reshape(320, 2, 240, 2, 3).mean((1, 3))
    assert np.abs(large - photograph(GelModel.builtin(), BALL)).max() < 3
    with pytest.raises(InputError, match="crop"):
        gel.resized(320, 320)


@pytest.mark.parametrize("kind", INDENTERS)
def test_every_indenter_touches_at_its_place_and_depth(kind):
    gel = GelModel.builtin()
    depth = press_depth(Press(kind, 3.0, 1.0, -2.0, 0.7, yaw_rad=0.4), gel)
    assert 0.5 < depth.max() <= 0.7 + 1e-5
    i, j = np.nonzero(depth > 0.9 * depth.max())
    assert np.mean((j + 0.5) * 12 / 59 - 6) == pytest.approx(1.0, abs=0.15)
    assert np.mean((i + 0.5) * 0.2 - 8) == pytest.approx(-2.0, abs=0.15)


def test_an_edge_lies_along_its_yaw():
    depth = press_depth(Press("edge", 6.0, 0, 0, 0.7, yaw_rad=0.5), GelModel.builtin())
    i, j = np.nonzero(depth > 0.5)
    slope = np.polyfit((j + 0.5) * 12 / 59 - 6, (i + 0.5) * 0.2 - 8, 1)[0]
    assert np.arctan(slope) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    "press", [BALL, Press("cube", 4.0, -1, 2, 0.5, 0.3), Press("edge", 6.0, 0, 0, 0.6, 1.0)]
)
def test_a_pair_is_refused_when_swapped_and_taken_when_not(press):
    gel = GelModel.builtin()
    rest, image = (
        photograph(gel, Press("sphere", 3.0, 0, 0, 1e-6), noise=3, seed=1),
        photograph(gel, press, 3),
    )
    fit_gel(rest, image, press, 20.0)
    with pytest.raises(InputError, match="swapped"):
        fit_gel(image, rest, press, 20.0)


def bad_pairs():
    gel = GelModel.builtin()
    rest, image = gel.rest_image, photograph(gel, BALL, 2)
    none = photograph(gel, Press("sphere", 3.0, 0, 0, 1e-6), 2)
    other = np.ascontiguousarray(rest[::-1, ::-1])
    yield "the same picture", rest, rest.copy(), BALL
    yield "shows no contact", rest, none, BALL
    yield "shows no contact", rest, image, Press("sphere", 3.0, -3, 5, 0.9)
    yield "lies outside the image", rest, image, Press("sphere", 3.0, 0, 30, 0.9)
    yield "another sensor", other, image, BALL
    yield "one size", rest[:200], image, BALL


@pytest.mark.parametrize("says, rest, image, press", list(bad_pairs()))
def test_bad_pairs_get_one_sentence(says, rest, image, press):
    with pytest.raises(InputError, match=says) as e:
        fit_gel(rest, image, press, 20.0)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("wrong", [{"indenter": "thumb"}, {"depth_mm": 0.0}, {"size_mm": float("nan")}])
def test_impossible_indenters_are_refused(wrong):
    with pytest.raises(InputError):
        Press(**{"indenter": "sphere", "size_mm": 3.0, "x_mm": 0, "y_mm": 0, "depth_mm": 0.5} | wrong)
