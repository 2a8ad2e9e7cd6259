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


def test_a_covered_camera_does_not_look_untouched(encoder):
    dark = encoder.difference(0.02 * encoder.rest_image[None]).abs().mean()
    assert dark > 0.4 * (encoder.rest_image.mean() / DIFFERENCE_SCALE)
