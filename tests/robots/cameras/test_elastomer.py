"""Any camera under a gel: turned, cut, mirrored and scaled in one place."""

import cv2
import draccus
import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs

from lerobot_camera_digit.digit import DigitConfig
from lerobot_camera_digit.elastomer import ElastomerConfig, Framing

PICTURE = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)


def test_by_itself_it_changes_nothing():
    assert Framing().apply(PICTURE) is PICTURE


def test_it_turns_clockwise_as_opencv_then_cuts_then_mirrors():
    turned = cv2.rotate(PICTURE, cv2.ROTATE_90_CLOCKWISE)  # 640 high, 480 wide
    framing = Framing(90, (0.1, 0.2, 0.0, 0.25), mirror=True)
    image = framing.apply(PICTURE)
    assert np.array_equal(image, turned[64:512, :360][:, ::-1])
    assert image.shape[:2] == framing.shape(480, 640) and image.flags.c_contiguous
    for degrees, code in ((180, cv2.ROTATE_180), (270, cv2.ROTATE_90_COUNTERCLOCKWISE)):
        assert np.array_equal(Framing(degrees).apply(PICTURE), cv2.rotate(PICTURE, code))


@pytest.fixture
def streaming(monkeypatch):
    """`cv2.VideoCapture` as a webcam that streams PICTURE, in BGR, in the size that it is given."""

    class Capture:
        def __init__(self, path, backend=0):
            self.controls = {}

        def isOpened(self):  # noqa: N802
            return True

        def set(self, control, value):
            self.controls[control] = value
            return True

        def get(self, control):
            return float(self.controls.get(control, 0))

        def read(self):
            size = int(self.controls[cv2.CAP_PROP_FRAME_WIDTH]), int(self.controls[cv2.CAP_PROP_FRAME_HEIGHT])
            return True, cv2.resize(PICTURE[..., ::-1], size, interpolation=cv2.INTER_NEAREST)

        def release(self):
            pass

    monkeypatch.setattr(cv2, "VideoCapture", Capture)


def test_an_opencv_camera_gives_the_image_that_its_options_ask_for(streaming):
    options = {"type": "elastomer", "index_or_path": 0, "stream": [640, 480], "rotation": 90, "mirror": True}
    config = draccus.decode(CameraConfig, options)
    camera = make_cameras_from_configs({"tactile": config})["tactile"]
    camera.connect(warmup=False)
    image = camera.async_read(1000)
    camera.disconnect()
    assert (config.height, config.width) == image.shape[:2] == (640, 480)
    assert np.array_equal(image, cv2.rotate(PICTURE, cv2.ROTATE_90_CLOCKWISE)[:, ::-1])


def test_what_is_known_of_a_make_is_taken_unless_it_is_reported_otherwise():
    mini = ElastomerConfig(index_or_path=0, sensor="gelsight_mini")
    assert (mini.stream, mini.fps, mini.width, mini.height) == ((3280, 2464), 25, 320, 240)
    own = ElastomerConfig(index_or_path=0, sensor="gelsight_mini", stream=(640, 480), crop=(0, 0, 0, 0))
    assert own.framing.apply(PICTURE).shape == (240, 320, 3)
    large = ElastomerConfig(
        index_or_path=0, sensor="gelsight_mini", stream=(640, 480), width=640, height=480, crop=(0, 0, 0, 0)
    )
    assert large.framing == Framing()
    digit = ElastomerConfig(index_or_path=0, sensor="digit")
    upright = DigitConfig(serial="D2")
    assert (digit.width, digit.height) == (upright.width, upright.height) == (240, 320)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"sensor": "taxim"}, "sensor is 'taxim'; it must be one of gelsight_mini, digit"),
        ({}, "stream of the elastomer's camera is missing"),
        ({"stream": (640, 480), "crop": (0.5, 0.5, 0, 0)}, "leave some of the picture"),
        ({"stream": (640, 480), "width": 320}, "give both, or neither for 640 x 480 px"),
    ],
)
def test_what_makes_no_image_is_one_sentence(options, text):
    with pytest.raises(DecodingError, match=text):
        ElastomerConfig(index_or_path=0, **options)
