"""Pairs of images that cannot be what they are said to be, and impossible indenters."""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import PressPhotograph, check_pair
from pneutac_sim.gel.photograph import Predictor

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
