"""A trained policy in a world of the studio, loaded and asked as `lerobot-eval` does, on the CPU."""

from pathlib import Path

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs.utils import preprocess_observation
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import OBS_IMAGES
from lerobot.utils.import_utils import register_third_party_plugins

from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME

TOUCH = f"{OBS_IMAGES}.{IMAGE_NAME}"


class PolicyPlayer:
    """A policy at the beginning of an episode.

    Args:
        name: folder of its weights, or its name on the Hub.
        task: the instruction.

    Raises:
        InputError: there is no policy, or it wants to see what the studio's world does not show.
    """

    def __init__(self, name: str, task: str):
        if not name:
            raise InputError(
                "Which policy? Give its folder, such as TRAINED/checkpoints/last/pretrained_model."
            )
        if Path(name).is_dir() and not (Path(name) / "config.json").is_file():
            raise InputError(
                f"{name} holds no policy (there is no config.json); give the folder of its weights, such as "
                "TRAINED/checkpoints/last/pretrained_model."
            )
        register_third_party_plugins()
        try:
            config = PreTrainedConfig.from_pretrained(name)
            config.device = "cpu"
            self._policy = get_policy_class(config.type).from_pretrained(name, config=config)
            on_cpu = {"device_processor": {"device": "cpu"}}
            processors = make_pre_post_processors(config, name, preprocessor_overrides=on_cpu)
        except InputError:
            raise
        except Exception as e:  # each kind of policy fails in its own way
            reason = (str(e).splitlines() or [type(e).__name__])[0].rstrip(".")
            raise InputError(f"The policy {name} cannot be loaded: {reason}.") from e
        if others := sorted(set(config.image_features) - {TOUCH}):
            raise InputError(f"The policy {name} looks at {', '.join(others)} too; here it has touch alone.")
        self._before, self._after = processors
        self._task = task
        self._policy.reset()

    def action(self, observation: dict) -> np.ndarray:
        """(3 + C,) as `features.action_names`, by an observation of `TaskEnv`."""
        batch = {"agent_pos": observation["agent_pos"][None], "pixels": dict(observation["pixels"])}
        prepared = self._before(preprocess_observation(batch) | {"task": [self._task]})
        with torch.inference_mode():
            action = self._after(self._policy.select_action(prepared))
        return action[0].cpu().numpy()
