"""The background of the tactile image, taken from the demonstrations themselves."""

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset

from lerobot_pneutac.policy.configuration_pneutac_bc import TACTILE

MAX_EPISODES = 16


def rest_image_of(meta) -> torch.Tensor:
    """Median over the first frames of up to 16 episodes, spread evenly over the dataset.

    A demonstration starts out of contact; the median forgives some that do not.

    Args:
        meta: LeRobotDatasetMetadata of a dataset with tactile images.

    Returns:
        (3, 320, 240) float32 in [0, 1].
    """
    n = min(meta.total_episodes, MAX_EPISODES)
    episodes = np.unique(np.linspace(0, meta.total_episodes - 1, n).round().astype(int)).tolist()
    dataset = LeRobotDataset(meta.repo_id, root=meta.root, episodes=episodes, revision=meta.revision)
    first = [int(meta.episodes[e]["dataset_from_index"]) for e in episodes]
    row = dataset.absolute_to_relative_idx
    frames = torch.stack([dataset[row[i]][TACTILE] for i in first])
    return frames.float().quantile(0.5, dim=0)
