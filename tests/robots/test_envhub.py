"""The folder `envhub` as LeRobot's EnvHub takes it, from a filled cache: nothing is asked of the Hub."""

import shutil
from pathlib import Path

import huggingface_hub.constants
import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.envs.factory import make_env

from lerobot_robot_pneutac.env import PneutacHubConfig
from pneutac_sim.world.expert import ScriptedExpert

FOLDER = Path(__file__).parents[2] / "envhub"
REVISION = "0" * 40


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache of the Hub in which lab/touch was downloaded."""
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    repo = tmp_path / "models--lab--touch"
    shutil.copytree(FOLDER, repo / "snapshots" / REVISION)
    (repo / "refs").mkdir()
    (repo / "refs" / "main").write_text(REVISION)
    return {"hub_cache_dir": str(tmp_path), "trust_remote_code": True}


@pytest.mark.slow
def test_each_sub_environment_is_scored_when_its_own_episode_ends(cache):
    env = make_env("lab/touch", n_envs=2, **cache)["pneutac"][0]
    env.reset(seed=[2, 3])
    world = env.envs[0].unwrapped.world
    expert = ScriptedExpert(world, np.random.default_rng(2))
    for _ in range(200):
        action = np.stack([expert.action(), np.zeros(4)]).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        if terminated.any():
            break
    assert terminated.tolist() == [True, False] and reward.tolist() == [1, 0] and not truncated.any()
    # As lerobot-eval reads it; the sub-environment that is done has begun anew in the same step.
    assert info["final_info"]["is_success"].tolist() == [True, False]
    assert not world.success and world.time_s == 0
    assert env.call("task") == ("switch", "switch") and env.call("_max_episode_steps") == (300, 300)
    env.close()


def test_a_folder_is_tried_before_it_is_uploaded(tmp_path):
    config = PneutacHubConfig(hub_path=str(FOLDER), task="card", episode_length=2)
    env = make_env(config, n_envs=1)["pneutac"][0]
    env.reset(seed=[1])
    assert env.call("task") == ("card",) and env.call("_max_episode_steps") == (2,)
    env.close()
    with pytest.raises(DecodingError, match="has no env.py; give one like envhub"):
        PneutacHubConfig(hub_path=str(tmp_path))


def test_a_repo_must_be_named():
    with pytest.raises(DecodingError, match="--env.hub_path is missing"):
        PneutacHubConfig()
