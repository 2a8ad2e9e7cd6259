"""Scene cameras and looks of the scene drawn at random."""

import gymnasium
import numpy as np
import pytest

import pneutac_sim  # noqa: F401  registers the environments
from pneutac_sim.errors import InputError
from pneutac_sim.world.scene import SCENE_CAMERAS
from pneutac_sim.world.task_env import SceneCameras
from pneutac_sim.world.world import World

SMALL = dict.fromkeys(SCENE_CAMERAS, (48, 64))


@pytest.fixture(scope="module")
def world():
    world = World("switch", touch="none")
    yield world
    world.close()


def make(**options):
    return gymnasium.make("pneutac_sim/switch", fidelity="probe", **options)


def test_pictures_are_in_the_observation_and_the_episode_is_the_same():
    plain, seen = make(), make(cameras=SMALL, randomise_look=True)
    before, after = plain.reset(seed=3)[0], seen.reset(seed=3)[0]
    assert set(before["pixels"]) == {"tactile"} and set(after["pixels"]) == {"tactile", *SCENE_CAMERAS}
    for _ in range(5):
        action = np.array([0.05, 0, -0.03, 9.0], np.float32)
        before, after = plain.step(action)[0], seen.step(action)[0]
        assert seen.observation_space.contains(after)
        assert np.array_equal(before["agent_pos"], after["agent_pos"])
        assert np.array_equal(before["pixels"]["tactile"], after["pixels"]["tactile"])
    plain.close(), seen.close()


def test_the_seed_decides_the_look_and_every_episode_has_another(world):
    cameras = SceneCameras(world, {"front": (48, 64)}, randomise_look=True)

    def look(seed):
        world.reset(5)
        cameras.begin(seed)
        return cameras.pictures()["front"].astype(float)

    first, second, again, other = look(5), look(None), look(5), look(6)
    assert np.array_equal(first, again)
    for different in (second, other):
        assert np.abs(different - first).mean() > 5


def test_what_the_scene_does_not_have_is_named(world):
    with pytest.raises(InputError, match="no camera 'back' in the scene; choose of front, side, wrist"):
        SceneCameras(world, {"back": (48, 64)})
    with pytest.raises(InputError, match="1281 px wide"):
        SceneCameras(world, {"front": (48, 1281)})
