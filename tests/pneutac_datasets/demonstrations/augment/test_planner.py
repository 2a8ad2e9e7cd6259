"""The planner on a world that is written down; `demonstrations/test_planner.py` tries it on the gantry."""

import numpy as np
import pytest

from pneutac_datasets.demonstrations.augment.planner import CemPlanner, PlannerConfig, demonstration_cost
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW

H = 6
JITTER = np.array([0.006, 0.006, 0.006, 0.6])
WARM = np.outer(np.linspace(0.2, 0.5, H), ACTION_HIGH)
STILL = np.zeros(4)
NOWHERE = np.zeros(H), np.zeros((H, 3))


class Written:
    """A flange that goes where it is told, at 15 Hz, and touches by its pressure; keeps what was tried."""

    action_limits = ACTION_LOW, ACTION_HIGH

    def __init__(self):
        self.tried = []

    def rollouts(self, batch):
        self.tried.append(batch.copy())
        return np.cumsum(batch[..., :3], 1) / 15, batch[..., 3] / 30

    def rollout(self, actions):
        position, area = self.rollouts(actions[None])
        return position[0], area[0]


def planner(seed=0, **options):
    config = PlannerConfig(**{"horizon": H, "replan": 2} | options)
    return CemPlanner(Written(), config, np.random.default_rng(seed))


def batches(p, size):
    """The batches (iterations, samples, H, 4) that a planner tried."""
    tried = np.concatenate([t.reshape(-1, *t.shape[-2:]) for t in p._gantry.tried])
    return tried.reshape(-1, size, *tried.shape[1:])


def cost(p, batch):
    """Of each sequence (n, H, 4), where nothing is the goal."""
    position, area = Written().rollouts(batch)
    return np.array(
        [
            demonstration_cost(c, NOWHERE[0], x, NOWHERE[1], a, STILL, p._config)
            for c, x, a in zip(area, position, batch, strict=True)
        ]
    )


FROM_ZERO = ("area_weight", "position_weight", "smoothness_weight", "jitter_m_s", "jitter_kpa")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"horizon": 1, "replan": 1}, "horizon is 1; it must be 2 or more"),
        ({"iterations": 0}, "iterations is 0; it must be 1 or more"),
        ({"elites": 11, "samples": 10}, r"elites is 11; it must be at most samples \(10\)"),
        ({"replan": 11, "horizon": 10}, r"replan is 11; it must be at most horizon \(10\)"),
        *(({o: x}, f"{o} is {x}; it must be a number from 0 on") for o in FROM_ZERO for x in (-0.1, np.nan)),
    ],
)
def test_a_number_out_of_its_range_is_named(given, said):
    with pytest.raises(InputError, match=f"^{said}"):
        PlannerConfig(**given)


def test_numbers_at_the_ends_of_their_ranges_are_taken():
    PlannerConfig(2, 3, 2, 1, 1, *[0.0] * len(FROM_ZERO))
    PlannerConfig(horizon=10, samples=10, elites=10, replan=10)


def test_the_jitter_has_its_spread_at_every_step_and_is_correlated_in_time():
    p = planner(samples=4000, iterations=1)
    p.plan(WARM, STILL, *NOWHERE)
    (batch,) = batches(p, 4000)
    np.testing.assert_array_equal(batch[:2], [WARM, WARM])
    noise = (batch[2:] - WARM) / JITTER
    assert np.abs(noise.mean(0)).max() < 0.08
    np.testing.assert_allclose(noise.std(0), 1, rtol=0.05)
    for t in range(1, H):
        one, two = noise[:, t - 1], noise[:, t]
        np.testing.assert_allclose((one * two).mean(0), 0.7, atol=0.06)
    np.testing.assert_allclose((noise[:, 0] * noise[:, 2]).mean(0), 0.49, atol=0.06)
    assert np.abs((noise[..., 0] * noise[..., 1]).mean()) < 0.05


def test_nothing_beyond_the_limits_is_tried():
    p = planner(samples=50, iterations=2)
    plan = p.plan(1.5 * np.tile(ACTION_HIGH, (H, 1)), STILL, *NOWHERE)
    for actions in (*batches(p, 50), plan):
        assert (actions <= ACTION_HIGH).all() and (actions >= ACTION_LOW).all()
    assert (batches(p, 50)[0, 0] == ACTION_HIGH).all()


def test_the_plan_is_the_best_that_was_tried():
    p = planner(seed=3)
    assert p.cost == 0
    plan = p.plan(WARM, STILL, *NOWHERE)
    tried = np.concatenate(batches(p, 10))
    costs = cost(p, tried)
    assert p.cost == pytest.approx(costs.min()) and costs.min() < costs[0]
    np.testing.assert_array_equal(plan, tried[np.argmin(costs)])
    assert len(tried) == 20
