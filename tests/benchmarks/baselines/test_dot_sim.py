import numpy as np
import pytest
import torch

from lerobot_pneutac.study.pasted import RestAlone
from pneutac_benchmarks.baselines import dot_sim
from pneutac_benchmarks.baselines.dot_sim import DotSim
from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.pair import Pair

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def briefly_trained(generated, fit):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dot_sim, "STEPS", 60)
        patch.setattr(dot_sim, "CHANNELS", 8)
        return fit(DotSim, generated), fit(DotSim, generated)


@pytest.mark.nightly
def test_beats_the_rest_image_on_unseen_contacts(generated, briefly_trained, scores):
    got, rest = scores(briefly_trained[0], generated), scores(RestAlone, generated)
    assert got.rmse < 0.75 * rest.rmse and got.contact_dncc > 0.8


@pytest.mark.nightly
def test_two_fits_render_the_same(generated, briefly_trained):
    press = generated.samples[1].press
    one, two = (model.image(press) for model in briefly_trained)
    np.testing.assert_array_equal(one, two)


def test_fitting_leaves_the_global_random_state(generated, fit, monkeypatch):
    monkeypatch.setattr(dot_sim, "STEPS", 2)
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    fit(DotSim, generated)
    assert torch.equal(torch.rand(3), expected)


def test_an_untrained_network_changes_nothing():
    network = dot_sim._UNet()
    assert not network(torch.rand(1, 3, 16, 20)).any()


@pytest.mark.nightly
def test_other_indenters_show_where_they_press(generated, briefly_trained):
    image = briefly_trained[0].image(Press("cube", 2.0, -2.0, 3.0, 1.0, yaw_rad=0.3)).astype(int)
    difference = np.abs(image - generated.rest).mean(2)
    assert image.shape == generated.rest.shape
    assert difference[170:270, 30:130].max() > 20 > difference[:100].max()


def test_images_of_two_sizes_are_refused(generated):
    c = generated.calibration
    with pytest.raises(InputError, match="one size"):
        DotSim.fit(Pair(generated.rest[:-1], c.image, c.press, generated.px_per_mm))


@pytest.mark.nightly
def test_photographs(photographs, scores):
    data = photographs("digit_fots")
    got = scores(DotSim, data)
    assert got.rmse < 0.6 * scores(RestAlone, data).rmse and got.contact_dncc > 0.85
