"""The planner on a world that is written down; `demonstrations/test_planner.py` tries it on the gantry."""

from dataclasses import FrozenInstanceError, astuple

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


def test_the_defaults_are_those_that_the_results_were_measured_with():
    config = PlannerConfig()
    assert astuple(config) == (10, 10, 3, 2, 5, 1.0, 50.0, 0.01, 0.006, 0.6)
    with pytest.raises(FrozenInstanceError):  # it was checked when it was made
        config.horizon = 1


@pytest.mark.parametrize(
    ("option", "least", "rest"),
    [
        ("horizon", 2, {"replan": 1}),
        ("samples", 3, {"elites": 2}),
        ("elites", 2, {}),
        ("iterations", 1, {}),
        ("replan", 1, {}),
    ],
)
def test_too_small_a_number_is_named(option, least, rest):
    assert getattr(PlannerConfig(**rest, **{option: least}), option) == least
    with pytest.raises(InputError, match=rf"^{option} is {least - 1}; it must be {least} or more"):
        PlannerConfig(**rest, **{option: least - 1})


@pytest.mark.parametrize(("option", "limit"), [("elites", "samples"), ("replan", "horizon")])
def test_what_exceeds_another_number_is_named(option, limit):
    assert PlannerConfig(**{option: 10, limit: 10})
    with pytest.raises(InputError, match=rf"^{option} is 11; it must be at most {limit} \(10\)"):
        PlannerConfig(**{option: 11, limit: 10})


@pytest.mark.parametrize(
    "option", ["area_weight", "position_weight", "smoothness_weight", "jitter_m_s", "jitter_kpa"]
)
def test_weights_and_spreads_are_numbers_from_zero_on(option):
    assert getattr(PlannerConfig(**{option: 0.0}), option) == 0
    for bad in (-0.1, np.nan, np.inf):
        with pytest.raises(InputError, match=f"^{option} is {bad}; it must be a number from 0 on"):
            PlannerConfig(**{option: bad})


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


def test_the_seed_decides_the_plan():
    plans = [planner(seed).plan(WARM, STILL, *NOWHERE) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(plans[0], plans[1])
    assert (plans[0] != plans[2]).any()
