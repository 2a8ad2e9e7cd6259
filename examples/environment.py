"""The switch as a Gymnasium environment: a script feels for it and flips it; a film of it is kept."""

from pathlib import Path

import gymnasium
import numpy as np
from PIL import Image

import pneutac_sim  # noqa: F401  registers the environments
from pneutac_sim.world.expert import ScriptedExpert

env = gymnasium.make("pneutac_sim/switch")
observation, info = env.reset(seed=3)
expert = ScriptedExpert(env.unwrapped.world, np.random.default_rng(3))

frames, done = [], False
while not done:
    observation, reward, terminated, truncated, info = env.step(expert.action())
    done = terminated or truncated
    if len(frames) < 120:
        frames.append(Image.fromarray(observation["pixels"]["tactile"]))

print("flipped" if info["is_success"] else "not flipped", "state:", observation["agent_pos"].shape)
Path("outputs/environment").mkdir(parents=True, exist_ok=True)
frames[0].save("outputs/environment/tactile.webp", save_all=True, append_images=frames[1:], duration=67)
