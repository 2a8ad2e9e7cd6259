"""Physics and pictures of soft pneumatic fingers and camera-based touch; knows nothing of LeRobot.

Importing registers the Gymnasium environments `pneutac_sim/switch`, `pneutac_sim/egg`, `pneutac_sim/card`
and does nothing else.
"""

import gymnasium

from pneutac_sim.features import CONTROL_HZ, TASK_NAMES, TRIAL_S

for _task in TASK_NAMES:
    gymnasium.register(
        id=f"pneutac_sim/{_task}",
        entry_point="pneutac_sim.world.env:PneutacEnv",
        kwargs={"task": _task},
        max_episode_steps=TRIAL_S * CONTROL_HZ,
    )
