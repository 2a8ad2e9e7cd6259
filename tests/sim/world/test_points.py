"""Touch as data: displacement and force on a grid of the gel's face."""

import gymnasium
import numpy as np
import pytest

import pneutac_sim  # noqa: F401  registers the environments
from pneutac_sim.errors import InputError
from pneutac_sim.features import POINTS_SHAPE
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.points import contact_force_n, tactile_points
from pneutac_sim.world.soft_finger import GEL_FRICTION
from pneutac_sim.world.world import World


@pytest.fixture(scope="module")
def pressed() -> World:
    """A world whose gel presses the switch, some way in."""
    world = World("switch", touch="area")
    world.reset(2)
    expert = ScriptedExpert(world, np.random.default_rng(2))
    while world.press_n < 0.4:
        world.step(expert.action())
    return world


def test_forces_sum_to_the_one_of_the_gels_spring(pressed):
    total = tactile_points(pressed)[..., 3:].sum((0, 1))
    np.testing.assert_allclose(total, contact_force_n(pressed.model, pressed.data), rtol=1e-5)
    assert total[2] == pytest.approx(-pressed.press_n, rel=0.05)
    # It slides: Coulomb's limit, but for the round bar's normal, which is not quite the gel's.
    assert np.abs(total[:2]).max() < 1.01 * GEL_FRICTION * abs(total[2])


def test_the_environment_has_them_where_asked_for():
    env = gymnasium.make("pneutac_sim/switch", touch="area", fidelity="probe", points=True)
    observation, _ = env.reset(seed=2)
    assert env.observation_space.contains(observation)
    assert observation["tactile.points"].size == np.prod(POINTS_SHAPE)
    with pytest.raises(InputError, match="no tactile points with touch 'none'"):
        gymnasium.make("pneutac_sim/switch", touch="none", points=True)
