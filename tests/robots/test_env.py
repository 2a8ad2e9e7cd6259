from dataclasses import replace

import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.envs.factory import make_env
from lerobot.envs.utils import env_to_policy_features, preprocess_observation

from lerobot_robot_pneutac.env import PneutacEnvConfig, PneutacStandinConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.standin.world import StandinWorld
from pneutac_sim.twin import Twin
from pneutac_sim.world.world import World


@pytest.mark.parametrize(
    ("config", "world"),
    [
        (PneutacEnvConfig(task="switch", episode_length=3), World),
        (PneutacStandinConfig(task="card", episode_length=3), StandinWorld),
    ],
)
def test_environment_gives_what_the_config_promises(config, world):
    env = make_env(config, n_envs=1)[config.type][0]
    assert isinstance(env.envs[0].unwrapped.world, world)
    observation, _ = env.reset(seed=[1])
    found = {k: tuple(v.shape[1:]) for k, v in preprocess_observation(observation).items()}
    promised = {k: f.shape for k, f in env_to_policy_features(config).items()}
    assert promised.pop("action") == env.single_action_space.shape
    assert found == promised
    for step in range(3):
        *_, truncated, _ = env.step(np.zeros((1, 4), np.float32))
        assert truncated[0] == (step == 2)
    env.close()


@pytest.mark.parametrize("config", [PneutacEnvConfig, PneutacStandinConfig])
def test_scene_cameras_come_under_lerobots_names(config):
    size = {"observation_height": 48, "observation_width": 64}
    more = {"randomise_look": True, "tactile_points": True}
    config = config(cameras=["front", "wrist"], **more, episode_length=3, **size)
    features = {k: f.shape for k, f in env_to_policy_features(config).items()}
    assert features["observation.images.front"] == features["observation.images.wrist"] == (3, 48, 64)
    env = make_env(config, n_envs=1)[config.type][0]
    found = {k: tuple(v.shape[1:]) for k, v in preprocess_observation(env.reset(seed=[1])[0]).items()}
    assert found == {k: shape for k, shape in features.items() if k != "action"}
    env.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"cameras": ["back"]}, "--env.cameras: There is no camera 'back' in the scene; choose of front"),
        ({"task": "juggle"}, "'juggle'; it must be one of switch, egg, card"),
        ({"fps": 30}, "controlled at 15 Hz"),
        ({"episode_length": 0}, "episode_length is 0; it must be 1 or more"),
        ({"episode_length": 10**9}, "episode_length is 1000000000; it must be 1 or more and at most 1e"),
        ({"twin": "/nowhere"}, "holds no twin.yaml"),
    ],
)
def test_bad_options_are_named(options, said):
    for config in (PneutacEnvConfig, PneutacStandinConfig):
        with pytest.raises(DecodingError, match=said):
            config(**options)


@pytest.mark.parametrize("config", [PneutacEnvConfig, PneutacSimConfig])
def test_a_gels_twin_is_no_fingers(config, tmp_path):
    replace(Twin.builtin(), device="gel").save(tmp_path)
    with pytest.raises(DecodingError, match="twin is .*, the twin of a gel; give that of a finger"):
        config(twin=tmp_path)


def warm_twin(folder):
    from pneutac_sim.effects import get_effect

    twin = Twin.builtin()
    twin.effects["thermal"] = get_effect("thermal").start(15.0)
    twin.save(folder)
    return folder


def test_conditions_reach_the_world_from_the_command_line(tmp_path):
    import draccus

    given = [f"--twin={warm_twin(tmp_path)}", "--fidelity=probe", "--conditions={temperature_c: [26, 28]}"]
    env = make_env(draccus.parse(PneutacEnvConfig, args=given), n_envs=1)["pneutac"][0]
    world, drawn = env.envs[0].unwrapped.world, []
    for seed in (1, 2, 1):
        env.reset(seed=[seed])
        drawn.append(world.conditions["temperature_c"])
    assert drawn[0] == drawn[2] != drawn[1] and all(26 <= t <= 28 for t in drawn)
    env.close()
