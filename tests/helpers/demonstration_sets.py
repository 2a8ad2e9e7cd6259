"""Small LeRobotDatasets of demonstrations with images, whose numbers tests choose."""

import numpy as np

from pneutac_datasets.demonstrations.faults import TACTILE
from pneutac_datasets.demonstrations.save import create_dataset, quiet_encoders
from pneutac_sim.dataset_files import ACTION, STATE
from pneutac_sim.features import ACTION_NAMES, IMAGE_SHAPE, STATE_NAMES

FRAMES = 5  # of an episode of `write_demonstrations`


def features_of(names=STATE_NAMES, shape=IMAGE_SHAPE, video=False):
    """LeRobot's description of demonstrations."""
    image = {"dtype": "video" if video else "image", "shape": shape, "names": ["height", "width", "channels"]}
    return {
        STATE: {"dtype": "float32", "shape": (len(names),), "names": list(names)},
        ACTION: {"dtype": "float32", "shape": (4,), "names": list(ACTION_NAMES)},
        TACTILE: image | ({"info": {"is_depth_map": False}} if video else {}),
    }


def touching(area, names=STATE_NAMES):
    """A state of zeros but for the contact area."""
    return np.where(np.array(names) == "contact_area.pos", np.float32(area), np.float32(0))


def write_episodes(root, episodes, names=STATE_NAMES, fps=15, shape=IMAGE_SHAPE, task="press", video=False):
    """A dataset of episodes of frames, each a state, an action and an image, or one number for all of it."""
    dataset = create_dataset(
        f"local/{root.name}", root, fps, features_of(names, shape, video), "pneutac", video, 40
    )
    with quiet_encoders():
        for frames in episodes:
            for state, action, image in frames:
                row = {STATE: np.full(len(names), state, np.float32), ACTION: np.full(4, action, np.float32)}
                dataset.add_frame(row | {TACTILE: np.full(shape, image, np.uint8), "task": task})
            dataset.save_episode()
        dataset.finalize()
    return root


def write_demonstrations(folder, pressures=(12.0, 12.0), area=0.1, names=STATE_NAMES, fps=15):
    """A whole dataset of an arm that stands still, an episode of five frames for each pressure."""
    areas = np.broadcast_to(area, len(pressures))
    episodes = [
        [(touching(a, names), [0, 0, 0, kpa], 0)] * FRAMES for kpa, a in zip(pressures, areas, strict=True)
    ]
    return write_episodes(folder, episodes, names, fps)
