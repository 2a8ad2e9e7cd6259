"""Tests of the starts that a few demonstrations are spread over."""

import numpy as np
import pytest

from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim, SpreadStarts


def mean_distance_to_nearest(points, chosen):
    return np.linalg.norm(points[:, None] - points[chosen][None], axis=-1).min(1).mean()


def test_ten_chosen_starts_stand_for_all_better_than_ten_random_ones():
    rng = np.random.default_rng(0)
    points = rng.uniform(size=(200, 2))
    starts = SpreadStarts({k: np.append(p, 0.0)[None] for k, p in enumerate(points)})
    chosen = []
    for _ in range(10):
        chosen.append(starts.next())
        starts.done(chosen[-1])
    random = [mean_distance_to_nearest(points, rng.permutation(200)[:10]) for _ in range(500)]
    assert mean_distance_to_nearest(points, chosen) < np.quantile(random, 0.01)


def test_a_start_that_failed_is_not_begun_again_and_leaves_its_place_open():
    starts = SpreadStarts({7: np.zeros((1, 3)), 8: np.full((1, 3), 0.01), 9: np.ones((1, 3))})
    assert starts.next() == 8  # the middle of the two that are near
    assert starts.next() == 7  # failed: what is near to it is tried
    starts.done(7)
    assert starts.next() == 9
    starts.done(9)
    assert starts.next() == 8  # all were given


@pytest.mark.parametrize("seed", range(2))
def test_the_robot_begins_in_every_lane(seed):
    """Random starts of five episodes leave one of the three lanes out in four of ten cases."""
    robot = PneutacSim(PneutacSimConfig(id="spread", task="switch", seed=seed, standin=True, spread=40))
    robot.connect()
    begun = []
    for _ in range(5):
        begun.append(robot.world.flange_m[1])
        robot.world.task._rested_s = 9.0  # done
        robot.reset()
    robot.disconnect()
    assert set(np.round(np.array(begun) / 0.02)) == {-1.0, 0.0, 1.0}
