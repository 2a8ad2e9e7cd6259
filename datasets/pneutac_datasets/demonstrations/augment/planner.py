"""Model-predictive control by the cross-entropy method (CEM), guided by a demonstration's touch.

At each replanning CEM draws sequences of H actions around a warm start, tries them on the world's gantry, and
moves mean and spread to the best of them. The cost is the paper's (eq. mpc-impl)

    L = sum_t [ w (c_t - c*_t)^2 + lambda |x_t - x*_t|^2 ] + mu sum_t |a_t - a_{t-1}|^2

with contact area c (a fraction of the image), flange position x (m), and action a in units of its limits.
"""

from dataclasses import dataclass, replace

import numpy as np

from pneutac_datasets.demonstrations.augment.reference import frames_at
from pneutac_sim.errors import InputError, check_least
from pneutac_sim.features import ACTION_HIGH, CONTROL_HZ, MAX_PRESSURE_KPA, PRESSURES
from pneutac_sim.world.gantry import Gantry

SMALLEST_SPREAD = 0.1  # of the first spread, so that later iterations still look around
MEMORY = 0.7  # correlation of the jitter over 1/15 s: hands do not shake so fast


@dataclass(frozen=True)
class PlannerConfig:
    """Options of the planner; control steps are of 1/15 s, at another rate their number is scaled."""

    horizon: int = 10  # number of control steps that a plan looks ahead, H
    samples: int = 10  # number of action sequences that an iteration tries
    elites: int = 3  # number of the best sequences, which make the next mean and spread
    iterations: int = 2  # number of iterations of CEM at a replanning
    replan: int = 5  # number of control steps after which it plans again
    area_weight: float = 1.0  # weight of the squared error of the contact area, w
    position_weight: float = 50.0  # weight of the squared error of the flange position, lambda, 1/m2
    smoothness_weight: float = 0.01  # weight of the squared change of the action, mu
    jitter_m_s: float = 0.006  # spread of the velocities tried, m/s
    # spread of the pressures tried with a finger of 0 to 15 kPa; with another it is as large a share of its
    # range
    jitter_kpa: float = 0.6

    def __post_init__(self):
        check_least(2, horizon=self.horizon, elites=self.elites)
        check_least(3, samples=self.samples)
        check_least(1, iterations=self.iterations, replan=self.replan)
        for name, limit in (("elites", "samples"), ("replan", "horizon")):
            if getattr(self, name) > getattr(self, limit):
                raise InputError(
                    f"{name} is {getattr(self, name)}; it must be at most {limit} ({getattr(self, limit)})."
                )
        for name in ("area_weight", "position_weight", "smoothness_weight", "jitter_m_s", "jitter_kpa"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name} is {getattr(self, name)}; it must be a number from 0 on.")

    def at(self, control_hz: int) -> "PlannerConfig":
        """The same for a control rate: as many seconds, and a change of the action by as much a second."""
        return replace(
            self,
            horizon=max(2, frames_at(control_hz, self.horizon)),
            replan=frames_at(control_hz, self.replan),
            smoothness_weight=self.smoothness_weight * (control_hz / CONTROL_HZ) ** 2,
        )


def demonstration_cost(
    area: np.ndarray,
    area_goal: np.ndarray,
    position_m: np.ndarray,
    position_goal_m: np.ndarray,
    actions: np.ndarray,
    previous: np.ndarray,
    config: PlannerConfig,
    scale: np.ndarray = ACTION_HIGH,
) -> np.ndarray:
    """Cost L (...,) of trajectories of H steps against the demonstrated one.

    Args:
        area: (..., H) contact areas c.
        area_goal: (H,) demonstrated ones c*; NaN where none is demonstrated, and touch costs nothing.
        position_m: (..., H, 3) flange positions x.
        position_goal_m: (H, 3) demonstrated ones x*.
        actions: (..., H, 3 + C) as `features.action_names`.
        previous: (3 + C,) the action before them.
        config: the weights.
        scale: (3 + C,) the largest action, by which changes are divided.
    """
    before = np.broadcast_to(previous, (*actions.shape[:-2], 1, actions.shape[-1]))
    change = np.diff(actions, axis=-2, prepend=before) / scale
    return (
        config.area_weight * np.nansum((area - area_goal) ** 2, -1)
        + config.position_weight * np.sum((position_m - position_goal_m) ** 2, (-2, -1))
        + config.smoothness_weight * np.sum(change**2, (-2, -1))
    )


class CemPlanner:
    """Plans on a gantry, whose `mirror` sets where a plan starts; `config` is for its control rate.

    Attributes:
        cost: of the last plan.
    """

    def __init__(
        self, gantry: Gantry, config: PlannerConfig, rng: np.random.Generator, control_hz: int = CONTROL_HZ
    ):
        self._gantry, self._config, self._rng = gantry, config, rng
        self._rest = np.empty((0, len(gantry.action_limits[0])))
        self._memory = MEMORY ** (CONTROL_HZ / control_hz)
        self.cost = 0.0

    def plan(
        self, warm: np.ndarray, previous: np.ndarray, area_goal: np.ndarray, position_goal_m: np.ndarray
    ) -> np.ndarray:
        """The best sequence of actions (H, 3 + C) found from the gantry's mirrored state.

        The first iteration tries both the warm start itself and what is left of the last plan.

        Args:
            warm: (H, 3 + C) actions to start from.
            previous: (3 + C,) the last action that was carried out.
            area_goal: (H,) demonstrated contact areas after each action, see `demonstration_cost`.
            position_goal_m: (H, 3) demonstrated flange positions after each action.
        """
        c = self._config
        mean = warm.copy()
        mean[: len(self._rest)] = self._rest[: len(mean)]
        low, high = self._gantry.action_limits
        largest = np.maximum(-low, high)
        widths_kpa = (high - low)[PRESSURES]
        first = np.append([c.jitter_m_s] * 3, c.jitter_kpa * widths_kpa / MAX_PRESSURE_KPA)
        spread = np.tile(first, (len(warm), 1))
        tried, costs = np.empty((0, *warm.shape)), np.empty(0)
        for iteration in range(c.iterations):
            batch = mean + spread * self._noise(c.samples, warm.shape)
            if iteration == 0:
                batch[0], batch[1] = warm, mean
            batch = np.clip(batch, low, high)
            position, area = self._gantry.rollouts(batch)
            goals = area_goal, position, position_goal_m
            cost = demonstration_cost(area, *goals, batch, previous, c, largest)
            tried, costs = np.concatenate([tried, batch]), np.concatenate([costs, cost])
            elites = tried[np.argsort(costs, kind="stable")[: c.elites]]
            mean, spread = elites.mean(0), np.maximum(elites.std(0), SMALLEST_SPREAD * first)
        best = int(np.argmin(costs))
        self.cost, plan = float(costs[best]), tried[best]
        self._rest = plan[c.replan :]
        return plan

    def _noise(self, samples: int, shape: tuple[int, ...]) -> np.ndarray:
        """Unit normal noise (samples, steps, 3 + C), correlated in time."""
        noise, memory = self._rng.standard_normal((samples, *shape)), self._memory
        for t in range(1, shape[0]):
            noise[:, t] = memory * noise[:, t - 1] + np.sqrt(1 - memory**2) * noise[:, t]
        return noise
