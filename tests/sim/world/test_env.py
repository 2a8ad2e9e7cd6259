"""The Gymnasium environment; scene cameras and looks of the scene drawn at random."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import pneutac_sim  # noqa: F401  registers the environments
from pneutac_sim.errors import InputError
from pneutac_sim.features import TASK_NAMES
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.scene import SCENE_CAMERAS
from pneutac_sim.world.task_env import SceneCameras
from pneutac_sim.world.world import World


@pytest.mark.parametrize("task", TASK_NAMES)
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized")  # ours are in m/s and kPa
@pytest.mark.filterwarnings("ignore:.*getdefaultlocale")  # Taichi's
@pytest.mark.filterwarnings("error")
def test_check_env(task):
    check_env(gymnasium.make(f"pneutac_sim/{task}", render_mode="rgb_array").unwrapped)


def test_what_lerobot_reads():
    env = gymnasium.make("pneutac_sim/switch", max_episode_steps=7)
    assert env._max_episode_steps == 7
    assert env.unwrapped.task == "switch" and env.unwrapped.task_description == "Flip the toggle switch."
    assert env.unwrapped.metadata["render_fps"] == 15
    observation, info = env.reset(seed=0)
    assert info["is_success"] is False and info["clipped"] == 0
    assert observation["pixels"]["tactile"].shape == (320, 240, 3)
    assert env.render().shape == (360, 480, 3)
    for i in range(7):
        observation, reward, terminated, truncated, info = env.step(np.zeros(4, np.float32))
        assert env.observation_space.contains(observation)
        assert info["is_success"] is False and reward == 0 and not terminated
        assert truncated == (i == 6)


def test_episode_ends_with_success():
    env = gymnasium.make("pneutac_sim/switch", touch="area")
    env.reset(seed=2)
    expert = ScriptedExpert(env.unwrapped.world, np.random.default_rng(2))
    terminated = truncated = False
    while not (terminated or truncated):
        observation, reward, terminated, truncated, info = env.step(expert.action())
        assert env.observation_space.contains(observation)
    assert terminated and info["is_success"] and reward == 1 and info["failure"] == ""
    assert "pixels" not in observation


def test_seed_means_the_same_as_in_the_world_and_unseeded_starts_differ():
    env, world = PneutacEnv("switch", touch="none"), World("switch", touch="none", fidelity="surrogate")
    observation, _ = env.reset(seed=11)
    assert np.array_equal(observation["agent_pos"], world.reset(11).state)
    one, _ = env.reset()
    two, _ = env.reset()
    assert not np.array_equal(one["agent_pos"], two["agent_pos"])


def test_a_twin_or_its_folder_makes_an_environment(tmp_path):
    """A twin of another body has no networks yet: it deforms by formulas, and says so."""
    twin = Twin.builtin()
    twin.parameters |= {"gain_rad_per_kpa": Value(0.02), "poissons_ratio": Value(0.4)}
    twin.save(tmp_path / "twin")
    reached = []
    for given in (twin, tmp_path / "twin", str(tmp_path / "twin")):
        with pytest.warns(UserWarning, match="no networks of its own.*`pneutac surrogate`"):
            env = gymnasium.make("pneutac_sim/switch", twin=given, touch="none")
        env.reset(seed=0)
        reached.append(env.step(np.array([0, 0, 0, 8], np.float32))[0]["agent_pos"])
        assert env.unwrapped.world.twin.parameter("gain_rad_per_kpa") == 0.02
        assert env.unwrapped.world.finger is None
    assert np.array_equal(reached[0], reached[1]) and np.array_equal(reached[0], reached[2])
    with pytest.raises(InputError, match="no action network"):
        gymnasium.make("pneutac_sim/switch", twin=twin, touch="none", fidelity="surrogate")


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
