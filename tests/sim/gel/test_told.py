"""What presses told of a gel's light, and which one to add."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.photograph import PressPhotograph
from pneutac_sim.gel.told import DEEPEST, told

SHALLOW = Press("sphere", 3.0, 3.0, -4.0, 0.5)


@pytest.fixture(scope="module")
def fitted(photograph):
    """Photographs of a gel and the fit to them."""

    def fit(gel, *presses):
        pairs = [PressPhotograph(p, photograph(gel, p, 2, i), gel.rest_image) for i, p in enumerate(presses)]
        found = fit_presses(pairs, 20.0, ["near_light", "rest_colour"], makes=())
        return told(found.gel, found.channels, pairs)

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
    assert set(two.untold) < set(one.untold), "two places tell how far the lights are"
    assert any(name.startswith("near_light.distance_mm") for name in one.untold)


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
