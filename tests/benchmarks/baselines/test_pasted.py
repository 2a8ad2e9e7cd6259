from dataclasses import replace

import numpy as np
import pytest

from lerobot_pneutac.study.pasted import Pasted, RestAlone, shift
from pneutac_sim.errors import InputError
from pneutac_sim.gel.pair import Pair


def test_the_calibration_pasted_at_its_own_place_is_the_calibration(generated, fit):
    c = generated.calibration
    np.testing.assert_array_equal(fit(Pasted, generated).image(c.press), c.image)


def test_the_difference_moves_with_the_contact(generated, fit):
    c = generated.calibration
    moved = fit(Pasted, generated).image(replace(c.press, x_mm=c.press.x_mm + 0.5, y_mm=c.press.y_mm - 1.0))
    difference = c.image.astype(int) - generated.rest
    expected = np.clip(generated.rest[:-20, 10:] + difference[20:, :-10], 0, 255)
    np.testing.assert_array_equal(moved[:-20, 10:], expected)
    np.testing.assert_array_equal(moved[-20:], generated.rest[-20:])


def test_a_shift_beyond_the_image_leaves_nothing():
    assert not shift(np.ones((4, 5, 3)), 5, 0).any() and not shift(np.ones((4, 5, 3)), 0, -9).any()


def test_pasting_beats_the_rest_image_which_changes_nothing(generated, scores):
    pasted, rest = scores(Pasted, generated), scores(RestAlone, generated)
    assert pasted.rmse < 0.9 * rest.rmse and rest.contact_dncc == 0


def test_a_pair_of_two_sizes_is_refused(generated):
    c = generated.calibration
    for baseline in (Pasted, RestAlone):
        with pytest.raises(InputError, match="one size"):
            baseline.fit(Pair(generated.rest[:-1], c.image, c.press, 20.0))
