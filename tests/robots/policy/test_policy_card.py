import re
import shlex
from dataclasses import fields

import numpy as np
import pytest
from huggingface_hub import ModelCard
from lerobot.configs.default import DatasetConfig, EvalConfig
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot.rollout.configs import BaseStrategyConfig, RolloutConfig
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.env import PneutacEnvConfig
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from pneutac_datasets.demonstrations.save import create_dataset, quiet_encoders
from pneutac_sim.features import ACTION_NAMES, IMAGE_SHAPE, STATE_NAMES


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    root = tmp_path_factory.mktemp("card") / "demos"
    features = {
        OBS_STATE: {"dtype": "float32", "shape": (len(STATE_NAMES),), "names": list(STATE_NAMES)},
        ACTION: {"dtype": "float32", "shape": (4,), "names": list(ACTION_NAMES)},
        TACTILE: {"dtype": "image", "shape": IMAGE_SHAPE, "names": ["height", "width", "channels"]},
    }
    dataset = create_dataset("local/demos", root, 15, features, "pneutac", False, 2)
    colour = np.broadcast_to(np.array([90, 110, 70], np.uint8), IMAGE_SHAPE)
    with quiet_encoders():
        for _ in range(3):
            for _ in range(2):
                frame = {OBS_STATE: np.zeros(20, np.float32), ACTION: np.zeros(4, np.float32)}
                frame[OBS_STATE][STATE_NAMES.index("contact_area.pos")] = 0.1
                dataset.add_frame({**frame, TACTILE: colour, "task": "flip the switch"})
            dataset.save_episode()
        dataset.finalize()
    return LeRobotDatasetMetadata(dataset.repo_id, root)


def test_a_checkpoint_says_what_it_is(demonstrations, tmp_path):
    policy = make_policy(PneutacBCConfig(device="cpu", license="mit", tags=["press"]), demonstrations)
    folder = tmp_path / "checkpoints" / "000200" / "pretrained_model"
    policy.save_pretrained(folder)
    card = ModelCard.load(folder / "README.md")
    assert card.data.license == "mit"
    assert card.data.library_name == "lerobot"
    assert card.data.datasets == ["local/demos"]
    assert {"press", "pneutac_bc", "robotics"} <= set(card.data.tags)
    assert "`local/demos`, 3 episodes, 6 frames" in card.text
    assert "Task: flip the switch" in card.text
    assert "Steps: 200\n" in card.text
    assert "mean R, G, B: 90, 110, 70 of 255" in card.text
    assert "Control rate: 15 Hz" in card.text
    for name, unit in (("joint_3.vel", "rad/s"), ("ee_z.pos", "m"), ("contact_pixels.pos", "log(1 + pixels")):
        assert f"| `observation.state` | `{name}` | {unit}" in card.text
    low, high = (demonstrations.stats["action"][k][3] for k in ("min", "max"))
    assert f"| `action` | `pressure.pos` | kPa, {min(low, 0):g} to {max(high, 0):g} |" in card.text
    assert f"| `{TACTILE}` | 240 x 320 pixels" in card.text


def test_a_policy_without_touch_says_so(demonstrations, tmp_path):
    policy = make_policy(PneutacBCConfig(device="cpu", use_tactile=False), demonstrations)
    policy.save_pretrained(tmp_path / "policy")
    text = (tmp_path / "policy" / "README.md").read_text()
    assert "without touch" in text
    assert TACTILE not in text and "Rest image" not in text
    assert "`contact_area.pos` | share of the image's pixels that are in contact (not looked at)" in text
    assert "Steps" not in text


def test_the_cards_commands_name_options_that_exist(demonstrations):
    policy = make_policy(PneutacBCConfig(device="cpu"), demonstrations)
    block = re.search(r"```bash\n(.*?)```", policy.generate_model_card().text, re.S).group(1)
    commands = [shlex.split(c) for c in block.replace("\\\n", " ").strip().split("\n\n")]
    whole = {
        "lerobot-eval": EvalPipelineConfig,
        "lerobot-rollout": RolloutConfig,
        "lerobot-train": TrainPipelineConfig,
    }
    parts = {
        "policy": PneutacBCConfig,
        "env": PneutacEnvConfig,
        "eval": EvalConfig,
        "robot": PneutacSimConfig,
        "dataset": DatasetConfig,
        "strategy": BaseStrategyConfig,
    }
    assert [c[0] for c in commands] == list(whole)
    for program, *options in commands:
        assert "--policy.path=THIS" in options
        for option in options:
            head, *rest = option.removeprefix("--").split("=")[0].split(".")
            assert head in {f.name for f in fields(whole[program])}
            if rest and rest != ["path"]:
                assert rest == ["type"] or rest[0] in {f.name for f in fields(parts[head])}, option
