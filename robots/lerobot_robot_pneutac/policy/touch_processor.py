"""A LeRobot processor step that reads depth, force and place of a touch from the tactile image."""

from dataclasses import dataclass, field

import numpy as np
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry

from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME
from pneutac_sim.gel.inverse import TouchReader
from pneutac_sim.twin import Twin

NAMES = ("touch_depth_mm", "touch_force_n", "touch_area_mm2", "touch_x_mm", "touch_y_mm")


@ProcessorStepRegistry.register("pneutac_touch")
@dataclass
class TouchProcessorStep(ObservationProcessorStep):
    """Adds `NAMES` to a robot's observation; zeros where nothing touches.

    Attributes:
        twin: folder of a twin with a calibrated gel.
        image: name of the tactile image in the observation, uint8 (H, W, 3).

    Raises:
        InputError: there is no such twin, or it has no gel.
    """

    twin: str
    image: str = IMAGE_NAME
    _reader: TouchReader = field(init=False, repr=False)

    def __post_init__(self):
        twin = Twin.load(self.twin)
        if not twin.gel:
            raise InputError(f"The twin at '{self.twin}' has no gel; calibrate one with `pneutac calibrate`.")
        self._reader = TouchReader.of_twin(twin)

    def observation(self, observation):
        """The observation and what its image tells."""
        if self.image not in observation:
            raise InputError(f"The observation has no image '{self.image}'; name the tactile one.")
        touch = self._reader.read(np.asarray(observation[self.image]))
        x, y = np.nan_to_num(touch.centre_mm)
        values = touch.depth_mm, touch.force_n, touch.area_mm2, float(x), float(y)
        return observation | dict(zip(NAMES, values, strict=True))

    def get_config(self) -> dict:
        """What it is made from."""
        return {"twin": str(self.twin), "image": self.image}

    def transform_features(self, features):
        """The features and `NAMES`."""
        for name in NAMES:
            features[PipelineFeatureType.OBSERVATION][name] = PolicyFeature(FeatureType.STATE, (1,))
        return features
