import numpy as np
import pytest

from lerobot_pneutac.study.pasted import RestAlone
from pneutac_benchmarks.baselines.taxim import BINS, Taxim, _bins
from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.pair import Pair

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def taxim(generated, fit):
    return fit(Taxim, generated)


def test_bins_are_slope_angle_and_direction():
    y, x = np.mgrid[:9, :9]
    slope, direction = _bins(np.tan(np.radians(44.6)) * x.astype(float), 1.0)
    assert np.unique(slope).tolist() == [61]  # of 0.726 degrees each
    assert np.unique(direction).tolist() == [BINS // 2]  # along +x: the middle of -pi to pi
    assert np.unique(_bins(-0.3 * y, 1.0)[1]).tolist() == [BINS // 4]


def test_beats_the_rest_image_on_unseen_contacts(generated, taxim, scores):
    got, rest = scores(taxim, generated), scores(RestAlone, generated)
    assert got.rmse < 0.6 * rest.rmse and got.contact_dncc > 0.9


def test_two_fits_render_the_same(generated, taxim, fit):
    press = generated.samples[1].press
    np.testing.assert_array_equal(taxim.image(press), fit(Taxim, generated).image(press))


@pytest.mark.parametrize("indenter", ["cube", "cylinder", "edge", "cone"])
def test_other_indenters_show_where_they_press_and_nowhere_else(generated, taxim, indenter):
    image = taxim.image(Press(indenter, 2.0, -2.0, 3.0, 1.0, yaw_rad=0.3)).astype(int)
    difference = np.abs(image - generated.rest).mean(2)
    assert difference[170:270, 30:130].max() > 20
    assert difference[:100].max() < 5


def test_a_table_cannot_know_where_light_is_brighter(generated, taxim):
    """The same press elsewhere changes the rest image by the same amount, up to clipping and drift."""
    here, there = (
        taxim.image(Press("sphere", 3.0, x, 0.0, 0.8)).astype(int) - generated.rest for x in (-2, 2)
    )
    np.testing.assert_allclose(here[100:220, 20:140], there[100:220, 100:220], atol=4)


def test_shadows_darken_outside_the_contact_alone(generated, fit):
    """A dark wedge beside the ball is learnt and cast beside a ball elsewhere."""
    c = generated.calibration
    y, x = np.mgrid[: c.image.shape[0], : c.image.shape[1]]
    r, angle = np.hypot(x - c.x_px, y - c.y_px), np.arctan2(y - c.y_px, x - c.x_px)
    wedge = (np.abs(angle) < 0.4) & (r < 80) & (r > 1.1 * c.radius_px)
    dark = np.where(wedge[..., None], c.image - np.minimum(c.image, 60), c.image).astype(np.uint8)
    shadowed = Taxim.fit(Pair(generated.rest, dark, c.press, generated.px_per_mm))
    plain = fit(Taxim, generated)
    press = Press("sphere", 3.0, -2.0, -3.0, c.press.depth_mm)
    darker = (shadowed.image(press).astype(int) - plain.image(press)).mean(2)
    column, row = 120 - 40, 160 - 60
    assert darker[row - 5 : row + 5, column + 55 : column + 70].mean() < -25
    assert np.abs(darker[row - 5 : row + 5, column - 70 : column - 55]).mean() < 3


def test_swapped_images_are_refused(generated):
    c = generated.calibration
    with pytest.raises(InputError, match="swapped"):
        Taxim.fit(Pair(c.image, generated.rest, c.press, generated.px_per_mm))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "role", "share", "dncc"),
    [
        ("digit_nagoya", "heldout", 0.9, 0.75),
        ("digit_fots", "heldout", 0.6, 0.85),
        ("gelsight_thu", "known_depth", 0.4, 0.95),
    ],
)
def test_photographs(photographs, scores, name, role, share, dncc):
    data = photographs(name)
    got = scores(Taxim, data, role)
    assert got.rmse < share * scores(RestAlone, data, role).rmse and got.contact_dncc > dncc
