"""The reward of reinforcement learning: a weighted sum of named terms.

Progress and approach are differences between steps, so that going to and fro earns nothing. The paper names
progress, approach, contact, tactile depth, success and action rate; a spoilt trial costs as well.
"""

from dataclasses import dataclass

import numpy as np

# Weight of each term in one control step. Over an episode the whole progress earns 2, coming from 10 cm away
# 1.5, 50 steps of a good imprint 0.5, and success as much as all of these.
WEIGHTS: dict[str, float] = {
    "progress": 2.0,  # of the whole task
    "approach": 15.0,  # per metre
    "contact": 0.002,
    "depth": 0.008,
    "success": 4.0,
    "failure": -1.0,
    "action_rate": -0.0005,
}


@dataclass(frozen=True)
class Moment:
    """What the reward looks at after a control step.

    Attributes:
        progress: how much of the task is done.
        distance_m: gel to where the object should be touched.
        depth_mm: deepest point of the probe grid.
        success, failure: whether the trial has ended, and how.
    """

    progress: float
    distance_m: float
    depth_mm: float
    success: bool = False
    failure: bool = False


def reward_terms(
    before: Moment, after: Moment, goal_depth_mm: float, previous: np.ndarray, action: np.ndarray
) -> dict[str, float]:
    """The terms of one control step, before their weights.

    Args:
        before: the moment that the step began in.
        after: the one that it ended in.
        goal_depth_mm: imprint that does the task well.
        previous: last action (4,), each entry in [-1, 1].
        action: this action (4,).

    Returns:
        a value for every name of `WEIGHTS`: `depth` is 1 at the wanted imprint and falls to 0 at none and at
        twice of it, `action_rate` the mean square of the change.
    """
    wanted = 1 - abs(after.depth_mm - goal_depth_mm) / goal_depth_mm
    return {
        "progress": after.progress - before.progress,
        "approach": before.distance_m - after.distance_m,
        "contact": float(after.depth_mm > 0),
        "depth": max(0.0, wanted),
        "success": float(after.success),
        "failure": float(after.failure),
        "action_rate": float(np.mean(np.square(np.subtract(action, previous)))),
    }


def total(terms: dict[str, float]) -> float:
    """The reward: the terms, weighted and summed."""
    return sum(WEIGHTS[name] * value for name, value in terms.items())
