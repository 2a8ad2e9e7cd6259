import numpy as np
import pytest
from lerobot.configs import PipelineFeatureType
from lerobot.processor import ProcessorStepRegistry

from lerobot_robot_pneutac.policy.touch_processor import NAMES, TouchProcessorStep
from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin


@pytest.fixture
def step(tmp_path):
    twin = Twin("gel", 16.0)
    GelModel.builtin().into_twin(twin)
    twin.save(tmp_path / "touch")
    return TouchProcessorStep(str(tmp_path / "touch"))


def test_a_press_is_told_beside_the_rest_of_the_observation(step):
    image = TactileSensor().image(Press("sphere", 3.0, 1.5, -2.0, 0.8).depths())
    seen = step.observation({"tactile": image, "pressure.pos": 3.0})
    assert seen["touch_depth_mm"] == pytest.approx(0.8, rel=0.1) and seen["pressure.pos"] == 3.0
    assert (seen["touch_x_mm"], seen["touch_y_mm"]) == pytest.approx((1.5, -2.0), abs=0.2)
    assert 0.2 < seen["touch_force_n"] < 1.0 and seen["touch_area_mm2"] > 4
    nothing = step.observation({"tactile": TactileSensor().rest_image})
    assert all(nothing[name] == 0 for name in NAMES), "no NaN goes on"


def test_lerobot_finds_it_by_name_and_builds_it_from_its_own_config(step):
    made = ProcessorStepRegistry.get("pneutac_touch")(**step.get_config())
    assert made.twin == step.twin
    features = made.transform_features({PipelineFeatureType.OBSERVATION: {}})
    assert set(features[PipelineFeatureType.OBSERVATION]) == set(NAMES)


def test_a_twin_without_a_gel_and_an_observation_without_the_image_are_refused(step, tmp_path):
    Twin.builtin().save(tmp_path / "finger")
    with pytest.raises(InputError, match="has no gel"):
        TouchProcessorStep(str(tmp_path / "finger"))
    with pytest.raises(InputError, match="no image 'tactile'"):
        step.observation({"wrist": np.zeros((2, 2, 3), np.uint8)})
