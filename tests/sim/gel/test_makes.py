"""Priors of makes as files."""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.gel import builtin, makes
from pneutac_sim.gel.channel import priors
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, Layout, kept, recognise_rest
from pneutac_sim.gel.photograph import PressPhotograph


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    monkeypatch.setenv("PNEUTAC_PRIORS", str(tmp_path / "priors"))
    return tmp_path / "priors"


def test_a_layout_comes_back_from_its_file(tmp_path):
    sds = (1.0, 2.0, 30.0), (0.05, 0.1, 0.2), (0.05, 0.06, 0.5)
    rest = kept(builtin.rest_image((80, 80, 3)))
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
    assert makes.library() == (DIGIT,), "without any of one's own"
    press = Press("sphere", 3.0, 0.6, -1.0, 0.9)
    pair = PressPhotograph(press, photograph(linear, press, 2), linear.rest_image)
    fit = fit_presses([pair], 20.0, ["near_light", "rest_colour"], makes=())
    file = makes.save("lab", fit.gel, fit.channels, "a test")
    assert file == own / "lab.yaml"
    lab = makes.library()[1]
    assert lab.name == "lab" and recognise_rest(linear.rest_image, lab)[1] > 0.99
    light = np.array(lab.positions_mm) / np.linalg.norm(lab.positions_mm, axis=1)[:, None]
    np.testing.assert_allclose(light, -linear.light / np.linalg.norm(linear.light, axis=1)[:, None], atol=0.1)
    assert min(lab.distances_sd_mm) > 20, "one press does not tell how far the lights are"
    prior = priors(0, linear.light[0], lab, fit.channels[0]._effects)["near_light", "distance_mm"]
    assert prior[1] == lab.distances_sd_mm[0]


def test_what_is_no_prior_gets_one_sentence(own, linear, photograph):
    own.mkdir()
    (own / "bad.yaml").write_text("format: pneutac-prior-1\nred: {x_mm: far}\n")
    with pytest.raises(InputError, match="bad.yaml is no prior of a sensor"):
        makes.library()
    with pytest.raises(InputError, match="near_light and rest_colour"):
        makes.save("lab", linear, [], "a test")
