"""Physics and pictures of soft pneumatic fingers and camera-based touch; knows nothing of LeRobot.

Importing registers the Gymnasium environments `pneutac_sim/switch`, `pneutac_sim/egg`, `pneutac_sim/card`
and those of the tasks that other packages bring, and does nothing else.
"""

import gymnasium

from pneutac_sim.features import CONTROL_HZ, TRIAL_S, task_names


def register_tasks() -> None:
    """Registers the environments of all tasks that are installed."""
    known = {f"pneutac_sim/{task}": task for task in task_names()}
    for name in known.keys() - gymnasium.registry.keys():
        gymnasium.register(
            id=name,
            entry_point="pneutac_sim.world.env:PneutacEnv",
            vector_entry_point="pneutac_sim.world.vector_env:BatchedEnv",
            kwargs={"task": known[name]},
            max_episode_steps=TRIAL_S * CONTROL_HZ,
        )


register_tasks()
