"""What holds for every effect of the library."""

import numpy as np
import pytest

from pneutac_sim.effects import BodyEffect, Parameter, body_effects, get_effect, in_order, kernel
from pneutac_sim.effects.body_effect import SIGNALS
from pneutac_sim.errors import InputError

CHANNELS = {"pressure": 3, "joints": 4, "loads": 6, "markers": 5, "mount": 5}
EFFECTS = list(body_effects().values())


def signal(effect, n=400):
    rng = np.random.default_rng(0)
    x = np.repeat(rng.uniform(0, 12, (n // 20, CHANNELS[effect.signal])), 20, axis=0)
    x[100:200] += np.linspace(0, 3, 100)[:, None]
    return x


def conditions(effect, n=400):
    rng = np.random.default_rng(1)
    return rng.uniform(0.5, 5.0, (n, len(effect.columns)))


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_does_exactly_nothing_at_its_neutral_point(effect):
    x, dt = signal(effect), np.full(400, 0.05)
    dt[[150, 300]] = np.inf  # trials
    neutral = {k: v.value for k, v in effect.neutral().items()}
    np.testing.assert_array_equal(effect.apply(x, dt, neutral, conditions(effect)), x)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_does_something_at_its_start_and_stays_finite_within_its_bounds(effect):
    x, dt, c = signal(effect), np.full(400, 0.05), conditions(effect)
    rng = np.random.default_rng(2)
    top = float(np.abs(x).max())
    changed = False
    for trial in range(20):
        values = {}
        for p in effect.parameters:
            default, low, high = p.limits(top)
            u = rng.random()
            values[p.name] = (
                default if trial == 0 else low * (high / low) ** u if p.log else low + u * (high - low)
            )
        y = effect.apply(x, dt, values, c)
        assert np.isfinite(y).all()
        changed |= not np.array_equal(y, x)
    assert changed


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_one_call_equals_many_with_the_state_carried(effect):
    x, dt, c = signal(effect), np.full(400, 0.05), conditions(effect)
    dt[[0, 170]] = np.inf
    values = {k: v.value for k, v in effect.start(12.0).items()}
    whole = effect.apply(x, dt, values, c, np.zeros(effect.state_size(x.shape[1])))
    state = np.zeros(effect.state_size(x.shape[1]))
    parts = [effect.apply(x[i : i + 1], dt[i : i + 1], values, c[i : i + 1], state) for i in range(400)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_effects_act_stage_by_stage_in_a_fixed_order():
    names = [
        e.name for e in in_order(["creep", "base_tilt", "valve_lag", "dead_time", "creep", "stiffening"])
    ]
    assert names == ["dead_time", "valve_lag", "stiffening", "creep", "base_tilt"]
    stages = [list(SIGNALS).index(e.stage) for e in EFFECTS]
    assert stages == sorted(stages)


def test_an_unknown_effect_is_refused_with_those_that_exist():
    with pytest.raises(InputError, match="valve_lag"):
        get_effect("valve_lagg")


@kernel
def _nothing(x, dt, theta, conditions, state):
    pass


def malformed(**fields):
    BodyEffect(name="a", parameters=(), run=_nothing, summary="", experiment="", **fields)


def test_a_malformed_effect_is_refused():
    with pytest.raises(InputError, match="stage 'muscle' must be one of pneumatics"):
        malformed(stage="muscle")
    with pytest.raises(InputError, match="signal 'joints'"):
        malformed(stage="drive", signal="joints")
    with pytest.raises(InputError, match="must lie in"):
        Parameter("a", "", 2.0, 0.0, 1.0)
    with pytest.raises(InputError, match="logarithmic"):
        Parameter("a", "", 0.5, 0.0, 1.0, log=True)
