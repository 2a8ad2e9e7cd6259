"""The stand-in for reality: a second simulated robot, made of truths, which no twin describes beforehand.

Its finger, air, gel and light are those of `pneutac_truths`; arm and tasks are `pneutac_sim.world`'s, and
nothing else of it. Importing registers the Gymnasium environments `pneutac_standin/switch`,
`pneutac_standin/egg`, `pneutac_standin/card` and those of other packages' tasks, and does nothing else.
"""

import gymnasium

from pneutac_sim.features import CONTROL_HZ, TRIAL_S, task_names

for _task in task_names():
    gymnasium.register(
        id=f"pneutac_standin/{_task}",
        entry_point="lerobot_robot_pneutac.standin.world:standin_env",
        kwargs={"task": _task},
        max_episode_steps=TRIAL_S * CONTROL_HZ,
    )
