"""Small LeRobotDatasets of demonstrations with images, whose numbers tests choose."""

import numpy as np

from pneutac_datasets.demonstrations.faults import TACTILE
from pneutac_datasets.demonstrations.info import ACTION, STATE
from pneutac_datasets.demonstrations.save import create_dataset, quiet_encoders
from pneutac_sim.features import ACTION_NAMES, STATE_NAMES

FRAMES = 5  # of an episode


def write_demonstrations(folder, pressures=(12.0, 12.0), area=0.1, names=STATE_NAMES, fps=15):
    """A whole dataset of an arm that stands still, an episode of five frames for each pressure."""
    features = {
        STATE: {"dtype": "float32", "shape": (len(names),), "names": list(names)},
        ACTION: {"dtype": "float32", "shape": (4,), "names": list(ACTION_NAMES)},
        TACTILE: {"dtype": "image", "shape": (320, 240, 3), "names": ["height", "width", "channels"]},
    }
    with quiet_encoders():
        dataset = create_dataset("local/demos", folder, fps, features, "pneutac", False, FRAMES)
        for kpa, touched in zip(pressures, np.broadcast_to(area, len(pressures)), strict=True):
            state, action = np.zeros(len(names), np.float32), np.array([0, 0, 0, kpa], np.float32)
            state[list(names).index("contact_area.pos")] = touched
            for _ in range(FRAMES):
                image = np.zeros((320, 240, 3), np.uint8)
                dataset.add_frame({STATE: state, ACTION: action, TACTILE: image, "task": "press"})
            dataset.save_episode()
        dataset.finalize()
    return folder
