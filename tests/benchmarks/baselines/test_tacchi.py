import numpy as np
import pytest

from lerobot_pneutac.study.pasted import RestAlone
from pneutac_benchmarks.baselines.tacchi import Tacchi, _change, _start
from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.pair import Pair

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tacchi(generated, fit):
    return fit(Tacchi, generated)


def test_flat_gel_renders_as_the_rest_image(generated, tacchi):
    parameters = tacchi._parameters
    background = generated.rest.reshape(-1, 3)[:50].astype(float)
    change = _change(parameters, np.zeros((3, 50)), background, 2.5)
    np.testing.assert_allclose(change, 0, atol=1e-9)


def test_a_light_brightens_the_slope_that_faces_it():
    """The red light comes from +x: red grows where the surface rises towards the lights with -x."""
    light = np.array([[-80.0, 0.0], [0.0, 50.0], [0.0, -50.0]])  # levels per unit slope
    slopes = np.array([[-0.2, 0.2], [0.0, 0.0], [0.1, 0.1]])
    red = _change(_start(light, 0.3, 5.0), slopes, np.full((2, 3), 100.0), 2.5)[:, 0]
    assert red[0] > 5 and red[1] < -5


def test_beats_the_rest_image_on_unseen_contacts(generated, tacchi, scores):
    got, rest = scores(tacchi, generated), scores(RestAlone, generated)
    assert got.rmse < 0.6 * rest.rmse and got.contact_dncc > 0.85


def test_two_fits_render_the_same(generated, tacchi, fit):
    press = generated.samples[1].press
    np.testing.assert_array_equal(tacchi.image(press), fit(Tacchi, generated).image(press))


@pytest.mark.parametrize("indenter", ["cube", "cylinder", "edge", "cone"])
def test_other_indenters_show_where_they_press_and_nowhere_else(generated, tacchi, indenter):
    image = tacchi.image(Press(indenter, 2.0, -2.0, 3.0, 1.0, yaw_rad=0.3)).astype(int)
    difference = np.abs(image - generated.rest).mean(2)
    assert difference[170:270, 30:130].max() > 20
    assert difference[:100].max() < 5


def test_an_image_without_contact_is_refused(generated):
    c = generated.calibration
    with pytest.raises(InputError, match="same picture"):
        Tacchi.fit(Pair(c.image, c.image, c.press, generated.px_per_mm))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "role", "share", "dncc"),
    [
        ("digit_nagoya", "heldout", 0.87, 0.75),
        ("digit_fots", "heldout", 0.68, 0.82),
        ("gelsight_thu", "known_depth", 0.45, 0.95),
    ],
)
def test_photographs(photographs, scores, name, role, share, dncc):
    data = photographs(name)
    got = scores(Tacchi, data, role)
    assert got.rmse < share * scores(RestAlone, data, role).rmse and got.contact_dncc > dncc
