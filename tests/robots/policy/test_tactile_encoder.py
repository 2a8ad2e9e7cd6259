import numpy as np
import pytest
import torch

from lerobot_robot_pneutac.policy.tactile_encoder import DIFFERENCE_SCALE, TactileEncoder


@pytest.fixture
def encoder() -> TactileEncoder:
    encoder = TactileEncoder()
    encoder.rest_image.fill_(0.4)
    return encoder


def test_camera_noise_is_no_touch(encoder):
    """Noise of single pixels averages out before the sign is dropped."""
    rest = encoder.rest_image
    noisy = rest + 2 / 255 * torch.randn(rest.shape, generator=torch.Generator().manual_seed(0))
    seen = encoder.difference(noisy[None]).abs().mean() * 32  # levels
    assert seen < 0.35 * 2 * np.sqrt(2 / np.pi)  # of the mean that single pixels would have


def test_a_drift_of_the_light_is_no_touch_and_hides_none(encoder):
    rest = encoder.rest_image
    touched = rest.clone()
    touched[:, 100:200, 60:160] += torch.tensor([20.0, -15.0, 10.0])[:, None, None] / 255
    drift = torch.tensor([1.04, 0.97, 1.02])[:, None, None]
    dark, shown = encoder.difference(torch.stack([rest * drift, touched * drift])) * 32  # levels
    assert dark.abs().max() < 0.01
    expected = encoder.difference(touched[None])[0] * 32
    np.testing.assert_allclose(shown, (expected * drift).numpy(), atol=0.02)
    assert expected.abs().max() > 19


@pytest.mark.parametrize(
    ("shape", "small"), [((480, 640), (60, 80)), ((240, 320), (60, 80)), ((333, 250), (80, 60))]
)
def test_a_touch_is_where_it_is_at_any_size(shape, small):
    """A press over the upper left quarter is seen there, as strong as it is."""
    encoder = TactileEncoder((3, *shape))
    encoder.rest_image.fill_(0.4)
    touched = encoder.rest_image.clone()
    touched[:, : shape[0] // 2, : shape[1] // 2] += 20 / 255
    seen = encoder.difference(touched[None])[0] * 32  # levels
    assert seen.shape == (3, *small)
    expected = torch.zeros(small)
    expected[: small[0] // 2, : small[1] // 2] = 20
    inner = (seen.mean(0) - expected).abs() < 0.1
    assert inner.float().mean() > 0.97  # but for cells on the edge
    assert encoder(encoder.difference(touched[None])).shape == (1, 64)


def test_a_covered_camera_does_not_look_untouched(encoder):
    dark = encoder.difference(0.02 * encoder.rest_image[None]).abs().mean()
    assert dark > 0.4 * (encoder.rest_image.mean() / DIFFERENCE_SCALE)
