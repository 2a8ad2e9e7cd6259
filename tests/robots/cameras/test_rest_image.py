import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from lerobot_robot_pneutac.cameras.tactile import capture_rest_image, compare_rest_images
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel.contact import contact_area
from pneutac_sim.gel.model import GelModel


def test_rest_image_averages_noise_away(sensor, connected):
    image = capture_rest_image(connected(fps=60), frames=16)
    error = np.abs(image.astype(float) - sensor.upright)
    assert error.mean() < 0.8 < np.abs(sensor.noisy[0] - sensor.upright).mean()


@pytest.mark.parametrize("moves", ["ball", "light"])
def test_rest_image_refuses_motion(sensor, connected, moves):
    spot = np.zeros(IMAGE_SHAPE)
    spot[100:130, 50:80] = 12.0

    def frame(k):
        change = spot * (k % 12 > 8) if moves == "ball" else 0.5 * k
        return np.clip(sensor.noisy[k % 8] + change, 0, 255)

    sensor.frame = frame
    with pytest.raises(HardwareFault, match=r"rest image of DIGIT D2 was refused.*levels within 24 frames"):
        capture_rest_image(connected(fps=60), frames=24)


def test_recorded_frames_pass_unchanged_and_show_their_contact(sensor, connected):
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA is not set: no recorded DIGIT frames")
    folder = Path(os.environ["PNEUTAC_DATA"]) / "tactile" / "digit_nagoya"
    rest = cv2.imread(str(folder / "rest_sphere.jpg"))[..., ::-1]
    pressed = cv2.imread(str(folder / "images" / "sphere_frame_4.jpg"))[..., ::-1]
    noise = np.random.default_rng(0).integers(-1, 2, (4, *rest.shape))
    shown = [rest]
    sensor.frame = lambda k: np.clip(shown[0] + noise[k % 4], 0, 255)
    camera = connected(resolution="VGA")
    quiet = capture_rest_image(camera, frames=8)
    assert quiet.shape == (640, 480, 3)
    assert np.abs(quiet.astype(float) - rest).max() <= 1
    assert contact_area(camera.read(), quiet).area < 0.001
    shown[0] = pressed
    camera.read()
    # The recording's table puts a disc of 62 px radius here, 3.9 % of the image; light reaches further.
    assert contact_area(camera.read(), quiet).area > 0.02


@pytest.mark.parametrize(("level", "colour"), [(0, "black"), (255, "white")])
def test_a_rest_image_without_light_or_with_too_much_is_refused(sensor, connected, level, colour):
    sensor.frame = lambda k: np.clip(level + (k % 3), 0, 255) + np.zeros(IMAGE_SHAPE)
    with pytest.raises(HardwareFault, match=f"rest image of DIGIT D2 was refused: it is {colour} all over"):
        capture_rest_image(connected(fps=60), frames=8)


def _spot(levels):
    y, x = np.indices(IMAGE_SHAPE[:2])
    return levels * np.exp(-(((x - 160) / 25) ** 2 + ((y - 90) / 25) ** 2))[..., None]


@pytest.mark.parametrize(("levels", "said"), [(0, ""), (14, "an imprint that is left"), (60, "refused")])
def test_a_rest_image_is_compared_with_the_twins(caplog, levels, said):
    """A steady press and an imprint do not move, so that the frames alone do not show them."""
    gel = GelModel.builtin()
    rest = np.clip(1.04 * gel.rest_image + _spot(levels), 0, 255).astype(np.uint8)
    if said == "refused":
        with pytest.raises(HardwareFault, match=r"shows something at \(2.., -3..\) mm .* let nothing touch"):
            compare_rest_images(rest, gel, "DIGIT D2")
        return
    compare_rest_images(rest, gel, "DIGIT D2")
    assert said in caplog.text and bool(said) == bool(caplog.text)


def test_another_light_than_the_twins_is_warned_of(caplog):
    gel = GelModel.builtin()
    compare_rest_images((0.7 * gel.rest_image).astype(np.uint8), gel, "DIGIT D2")
    assert "DIGIT D2 is 30 % darker than when its twin was calibrated" in caplog.text
