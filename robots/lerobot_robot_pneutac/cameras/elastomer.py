"""The camera `elastomer`: LeRobot's OpenCV camera, whose pictures are turned, cut, mirrored and scaled."""

import numpy as np
from lerobot.cameras.opencv import OpenCVCamera, OpenCVCameraConfig

from lerobot_robot_pneutac.cameras.config_elastomer import ElastomerConfig


class Elastomer(OpenCVCamera):
    """Images are RGB uint8 of the options' `height` and `width`."""

    def __init__(self, config: ElastomerConfig):
        width, height = config.stream
        super().__init__(
            OpenCVCameraConfig(
                index_or_path=config.index_or_path,
                fps=config.fps,
                width=width,
                height=height,
                fourcc=config.fourcc,
            )
        )
        self._framing = config.framing

    def _postprocess_image(self, image: np.ndarray) -> np.ndarray:
        return self._framing.apply(super()._postprocess_image(image))
