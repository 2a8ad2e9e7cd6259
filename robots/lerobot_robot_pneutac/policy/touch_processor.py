"""A LeRobot processor step that reads depth, force and place of a touch from the tactile image."""

from dataclasses import dataclass, field

import numpy as np
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry

from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME
from pneutac_sim.gel.inverse import TouchReader
from pneutac_sim.twin import Twin

AREA, PIXELS = "contact_area.pos", "contact_pixels.pos"
NAMES = ("touch_depth_mm", "touch_force_n", "touch_area_mm2", "touch_x_mm", "touch_y_mm")


@ProcessorStepRegistry.register("pneutac_touch")
@dataclass
class TouchProcessorStep(ObservationProcessorStep):
    """Adds `NAMES` to a robot's observation; zeros where nothing touches.

    Raises InputError: there is no such twin, or it has no gel.
    """

    twin: str  # folder of a twin with a calibrated gel
    image: str = IMAGE_NAME  # name of the tactile image in the observation, uint8 (H, W, 3)
    # whether `contact_area.pos` and `contact_pixels.pos` become those of the contact that is read, in place
    # of all pixels that have changed; train and run a policy with the same
    contact_area: bool = False
    _reader: TouchReader = field(init=False, repr=False)

    def __post_init__(self):
        twin = Twin.load(self.twin)
        if not twin.gel:
            raise InputError(f"The twin at '{self.twin}' has no gel; calibrate one with `pneutac calibrate`.")
        self._reader = TouchReader.of_twin(twin)

    def observation(self, observation):
        """The observation with the touch that its image shows."""
        if self.image not in observation:
            raise InputError(f"The observation has no image '{self.image}'; name the tactile one.")
        image = np.asarray(observation[self.image])
        touch = self._reader.read(image)
        x, y = np.nan_to_num(touch.centre_mm)
        values = touch.depth_mm, touch.force_n, touch.area_mm2, float(x), float(y)
        out = observation | dict(zip(NAMES, values, strict=True))
        if self.contact_area:
            share, pixels = touch.contact.mean(), image.shape[0] * image.shape[1]
            out |= {AREA: float(share), PIXELS: float(np.log1p(share * pixels))}
        return out

    def get_config(self) -> dict:
        return {"twin": str(self.twin), "image": self.image, "contact_area": self.contact_area}

    def transform_features(self, features):
        """The features and `NAMES`."""
        for name in NAMES:
            features[PipelineFeatureType.OBSERVATION][name] = PolicyFeature(FeatureType.STATE, (1,))
        return features
